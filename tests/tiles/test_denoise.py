"""Tiles: the result of the whole cloud, from a plan that covers every point once, also after a kill."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from cablejax import PointCloud
from cablejax.batch import Processes
from cablejax.batch.child import START
from cablejax.io import read_points, write_points
from cablejax.ops import clean
from cablejax.tiles import Settings, TileError, denoise_file
from cablejax.tiles.folder import Folder
from cablejax.tiles.plan import add, cut, empty_grid
from tests.reference.circles import bent_cable

SETTINGS = Settings(removal_k=8, k=16)
CAPACITY, CHUNK = 2048, 1500


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    """A cable with strays, colours and intensities, and what `clean` makes of it at once."""
    rng = np.random.default_rng(1)
    xyz = np.concatenate([bent_cable(n=3900), rng.uniform(-60, 60, (60, 3)) + np.array([200, 0, 0])])
    xyz = xyz[rng.permutation(len(xyz))]
    path = tmp_path_factory.mktemp("tiles") / "scan.ply"
    write_points(path, xyz, color=rng.integers(0, 255, xyz.shape).astype(np.uint8), intensity=np.arange(len(xyz)))
    scan = read_points(path)
    whole = PointCloud.from_xyz(scan.xyz_mm - scan.shift_mm)
    result = clean(whole, removal_k=SETTINGS.removal_k, k=SETTINGS.k, order=2)
    keep = np.asarray(result.keep)[: len(xyz)]  # without the padding
    return path, np.asarray(result.xyz, dtype=np.float64)[: len(xyz)][keep] + scan.shift_mm, keep, scan


def test_equals_the_whole_cloud_and_keeps_order_and_colours(cloud, tmp_path):
    path, expected, keep, scan = cloud
    told = []
    result = denoise_file(
        path,
        tmp_path / "out.ply",
        settings=SETTINGS,
        tile_points=CAPACITY,
        chunk=CHUNK,
        progress=lambda *p: told.append(p),
    )
    written = read_points(tmp_path / "out.ply")
    # Both work in float32 within 300 mm of their own origin: steps of 3e-5 mm, a few of them.
    np.testing.assert_allclose(written.xyz_mm, expected, atol=3e-4)
    np.testing.assert_array_equal(written.color, scan.color[keep])
    np.testing.assert_array_equal(written.intensity, scan.intensity[keep])
    assert (result.points, result.removed, result.cut) == (3960, int((~keep).sum()), 0)
    assert result.tiles > 2
    assert ("smoothing", result.tiles, result.tiles) in told
    assert not (tmp_path / "out.ply.tiles").exists()


def test_goes_on_after_a_kill(cloud, tmp_path):
    path, expected, _, _ = cloud
    target = tmp_path / "out.ply"
    code = (
        "from cablejax.tiles import Settings, TileError, denoise_file\n"
        f"denoise_file({str(path)!r}, {str(target)!r}, settings=Settings(removal_k=8, k=16), tile_points={CAPACITY}, "
        f"chunk={CHUNK}, progress=lambda stage, i, n: print(stage, i, flush=True))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line == "smoothing 2\n":
            process.send_signal(signal.SIGKILL)
            break
    assert process.wait() == -signal.SIGKILL
    process.stdout.close()
    assert not target.exists()
    state = Folder.of_job(tmp_path / "out.ply.tiles", _job(tmp_path)).state["done"]
    assert "smoothing 0" in state
    before = time.time_ns()
    denoise_file(path, target, settings=SETTINGS, tile_points=CAPACITY, chunk=CHUNK, progress=lambda *p: None)
    assert target.stat().st_mtime_ns > before - 10**9
    np.testing.assert_allclose(read_points(target).xyz_mm, expected, atol=3e-4)


def _job(folder):
    import json

    return json.loads((folder / "out.ply.tiles" / "state.json").read_text())["job"]


def test_a_folder_of_another_job_is_emptied(tmp_path):
    Folder.of_job(tmp_path / "work", {"k": 1}).finish("survey", 5)
    assert Folder.of_job(tmp_path / "work", {"k": 1}).done("survey") == 5
    assert Folder.of_job(tmp_path / "work", {"k": 2}).done("survey") is None


def test_every_point_is_in_one_tile_and_its_halo_in_the_outer_box():
    xyz = bent_cable(n=5000)
    grid = empty_grid(xyz.min(axis=0), xyz.max(axis=0))
    add(grid, xyz)
    tiles = cut(grid, halo=4.0, capacity=1200)
    inner = np.array([tile.inner(xyz) for tile in tiles])
    outer = np.array([tile.outer(xyz) for tile in tiles])
    assert (inner.sum(axis=0) == 1).all()
    assert outer.sum(axis=1).max() <= 1200
    for own, wide, tile in zip(inner, outer, tiles, strict=True):
        apart = np.linalg.norm(xyz[own][:, None] - xyz[None], axis=2).min(axis=0)
        assert wide[apart < 4.0].all()
        assert (tile.slack(xyz[own]) >= 4.0 - 1e-9).all()


def test_too_small_a_tile_and_too_few_points_are_named(tmp_path):
    path = tmp_path / "few.ply"
    write_points(path, bent_cable(n=500))
    with pytest.raises(ValueError, match="tile_points: expected at least"):
        denoise_file(path, tmp_path / "out.ply", settings=SETTINGS, tile_points=10)
    with pytest.raises(ValueError, match="points: expected more than 600, got 500"):
        denoise_file(path, tmp_path / "out.ply", settings=Settings(k=600))


def test_tiles_on_processes_give_the_same_bit_for_bit_whatever_their_number_and_deaths(cloud, tmp_path, monkeypatch):
    path, expected, _, _ = cloud
    written = []
    for jobs, deadly in ((1, False), (2, True)):
        target, mark = tmp_path / f"jobs{jobs}.ply", tmp_path / "mark"
        if deadly:  # the first process dies in the middle of its second task
            first = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); import tests.tiles.mortal as m"
            monkeypatch.setattr("cablejax.batch.child.START", f"{first}; m.prepare({str(mark)!r})\n{START}")
        denoise_file(
            path,
            target,
            settings=SETTINGS,
            tile_points=CAPACITY,
            chunk=CHUNK,
            engine=Processes(jobs),
            progress=lambda *p: None,
        )
        written.append(target.read_bytes())
        assert mark.exists() == deadly
    assert written[0] == written[1]
    np.testing.assert_allclose(read_points(tmp_path / "jobs1.ply").xyz_mm, expected, atol=3e-4)


def test_work_that_fails_says_which_tile(cloud, tmp_path, monkeypatch):
    monkeypatch.setattr("cablejax.tiles.work.kernels.scores", lambda *_, **__: 1 / 0)
    with pytest.raises(TileError, match=r"scoring: tile \d+ of \d+: ZeroDivisionError"):
        denoise_file(cloud[0], tmp_path / "out.ply", settings=SETTINGS, tile_points=CAPACITY, chunk=CHUNK)
