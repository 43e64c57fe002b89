"""Scans are padded to few capacities: another size compiles nothing, and the padding changes no result."""

import collections
import json

import jax
import numpy as np
import pytest

from cablejax import PointCloud, traces
from cablejax.cli import main
from cablejax.cli.capacity import DOUBLING, LEAST, capacity
from cablejax.io import read_points, write_points
from cablejax.ops import clean
from tests.reference.circles import bent_cable

PER_OCTAVE = 8

COMPILED: collections.Counter[str] = collections.Counter()


def _count(event: str, _: float, **__: object) -> None:
    COMPILED[event.rsplit("/", 1)[-1]] += 1


jax.monitoring.register_event_duration_secs_listener(_count)


def compiled() -> int:
    """How many programs were compiled or loaded so far."""
    return COMPILED["backend_compile_duration"]


def test_few_capacities_and_little_padding():
    points = np.unique(np.geomspace(1, 3e6, 20_000).astype(int))
    found = np.array([capacity(int(n)) for n in points])
    assert (found >= points).all()
    doubled, above = (points > LEAST) & (points <= DOUBLING), points > DOUBLING
    assert (found[doubled] < 2 * points[doubled]).all()
    assert (found[above] - points[above] < points[above] / PER_OCTAVE).all()
    octaves = np.log2(points.max() / DOUBLING)
    assert len(np.unique(found)) <= np.log2(DOUBLING / LEAST) + 1 + PER_OCTAVE * np.ceil(octaves)
    assert all(capacity(int(n)) == n for n in found)  # a capacity is its own


@pytest.fixture
def scans(tmp_path):
    """Two scans of each of two capacities, 4,096 and the least, and their files."""
    files = []
    for n in (2100, 3900, 1500, 1900):
        files.append((str(tmp_path / f"{n}.ply"), bent_cable(n=n, seed=n)))
        write_points(*files[-1])
    return files


@pytest.fixture
def nothing_compiled(monkeypatch):
    """What tests before have compiled is not at hand."""
    for each in list(traces._ALL):
        monkeypatch.setattr(each, "_programs", {})
    jax.clear_caches()


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize(("options", "first"), [(["--no-filter"], 0), (["--neighbors", "12", "--order", "1"], 2)])
def test_a_scan_of_another_size_compiles_nothing(scans, tmp_path, options, first):
    command = ["--unit", "mm", "--quiet", *options]
    start = compiled()
    assert main(["denoise", scans[first][0], str(tmp_path / "out.ply"), *command]) == 0
    after_one = compiled()
    assert after_one > start  # the counter counts
    assert main(["denoise", scans[first + 1][0], str(tmp_path / "out.ply"), *command]) == 0
    assert compiled() == after_one


def test_measuring_a_scan_of_another_size_compiles_nothing(scans):
    main(["measure", scans[0][0], "--unit", "mm", "--quiet"])
    before = compiled()
    main(["measure", scans[1][0], "--unit", "mm", "--quiet"])
    assert compiled() == before


def test_the_padding_changes_no_result(scans, tmp_path, capsys):
    path, _ = scans[3]
    out = tmp_path / "out.ply"
    assert (
        main(["denoise", path, str(out), "--unit", "mm", "--neighbors", "12", "--order", "1", "--quiet", "--json"]) == 0
    )
    told = json.loads(capsys.readouterr().out)
    scan = read_points(path)
    exact = PointCloud.from_xyz(scan.xyz_mm - scan.shift_mm, capacity=1900)
    result = clean(exact, k=12, order=1)
    keep = np.asarray(result.keep)
    assert (told["points"], told["removed"]) == (1900, int((~keep).sum()))
    # 1e-3 mm: sums in another order, and PLY's float32, on coordinates of some 100 mm.
    np.testing.assert_allclose(read_points(out).xyz_mm, np.asarray(result.xyz)[keep] + scan.shift_mm, atol=1e-3)
    assert told["kernel_width_mm"] == pytest.approx(float(np.asarray(result.width)[keep].mean()), rel=1e-4)
