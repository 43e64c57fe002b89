"""Tiles of a COPC file fetch their own points; the result is that of a pass over the same points, byte for byte."""

import numpy as np
import pytest

from cablejax.batch import Processes
from cablejax.io import write_points
from cablejax.tiles import Settings, TileError, denoise_file
from cablejax.tiles.folder import Folder
from tests.io.copc_files import write_copc
from tests.reference.circles import bent_cable

laspy = pytest.importorskip("laspy")
SETTINGS = Settings(removal_k=8, k=16)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    """A cable with strays far from the origin as COPC, and the same points in the same order as PLY."""
    folder = tmp_path_factory.mktemp("copc")
    rng = np.random.default_rng(1)
    xyz = np.concatenate([bent_cable(n=3900), rng.uniform([140, -60, -60], [260, 60, 60], (60, 3))]) + np.array(
        [400_000, 5e6, 0]
    )
    write_copc(folder / "a.copc.laz", xyz)
    with laspy.open(folder / "a.copc.laz") as file:
        points = file.read()
    write_points(
        folder / "a.ply", np.stack([points.x, points.y, points.z], axis=1), intensity=np.asarray(points.intensity)
    )
    return folder


def cleaned(source, target, **options) -> tuple[bytes, int]:
    result = denoise_file(source, target, settings=SETTINGS, tile_points=2048, chunk=1500, **options)
    return target.read_bytes(), result.tiles


@pytest.mark.parametrize("jobs", [0, 2])
def test_equals_a_pass_over_the_same_points(cloud, tmp_path, monkeypatch, jobs):
    options = {"engine": Processes(jobs)} if jobs else {}
    by_pass, tiles = cleaned(cloud / "a.ply", tmp_path / "pass.ply", **options)
    monkeypatch.setattr(Folder, "spool", None)  # no pass that writes tiles
    by_region, _ = cleaned(cloud / "a.copc.laz", tmp_path / "region.ply", **options)
    assert tiles > 2
    assert by_region == by_pass


@pytest.mark.parametrize("kind", ["withheld points", "beams without return"])
def test_where_returns_were_left_out_all_are_passed_over(tmp_path, kind):
    """Rows of the file are then not those of the points."""
    xyz = bent_cable(n=2500)
    if kind == "beams without return":
        xyz[[5, 900]] = 0.0
    write_copc(tmp_path / "a.copc.laz", xyz, withheld=[7] if kind == "withheld points" else ())
    result = denoise_file(tmp_path / "a.copc.laz", tmp_path / "out.ply", settings=SETTINGS, tile_points=2048)
    assert result.dropped == {"withheld points": 1, "beams without return": 2}[kind]
    assert result.points == 2500 - result.dropped


def test_an_octree_that_does_not_hold_its_points_is_told(cloud, tmp_path):
    data = bytearray((cloud / "a.copc.laz").read_bytes())
    half = 375 + 54 + 24  # half the side of the root
    data[half : half + 8] = np.float64(1.0).tobytes()
    (tmp_path / "a.laz").write_bytes(data)
    with pytest.raises(TileError, match=r"a\.laz: its octree does not hold all points where it says: [\d,]+ of 3,960"):
        cleaned(tmp_path / "a.laz", tmp_path / "out.ply")
