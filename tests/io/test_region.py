"""Part of a COPC file: the points of a box with their rows, bit for bit those of the whole, and nothing else decoded."""

import numpy as np
import pytest

from cablejax.io import PointFileError, is_copc, read_points, read_region, write_points
from tests.io.copc_files import write_copc
from tests.reference.circles import bent_cable

laspy = pytest.importorskip("laspy")
XYZ = bent_cable(n=3000) + np.array([400_000.0, 0.0, -30.0])
BOXES = {
    "all": ([-np.inf] * 3, [np.inf] * 3),
    "a half": ([400_100.0, -np.inf, -np.inf], [np.inf] * 3),
    "a slab": ([400_050.0, -1e3, -1e3], [400_080.0, 1e3, 1e3]),
    "nothing": ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
}


@pytest.fixture(scope="module", params=[False, True], ids=["one page", "two pages"])
def copc(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("copc") / "a.copc.laz"
    write_copc(path, XYZ, page=request.param)
    return path


@pytest.mark.parametrize("unit", ["mm", "m", "in"])
@pytest.mark.parametrize("box", BOXES)
def test_a_box_holds_what_the_whole_holds_there(copc, box, unit):
    whole = read_points(copc, unit=unit).xyz_mm
    low, high = (np.array(corner) * (whole[:, 0].max() / XYZ[:, 0].max()) for corner in BOXES[box])
    found = read_region(copc, low, high, unit=unit)
    within = ((whole >= low) & (whole <= high)).all(axis=1)
    np.testing.assert_array_equal(found.row, np.flatnonzero(within))
    np.testing.assert_array_equal(found.xyz_mm, whole[within])


def test_points_on_the_sides_are_within(copc):
    whole = read_points(copc, unit="m").xyz_mm
    for row in (0, 1500, 2999):
        found = read_region(copc, whole[row], whole[row], unit="m")
        assert row in found.row


def test_other_nodes_are_not_decoded(copc, tmp_path):
    with laspy.CopcReader.open(copc) as reader:
        nodes = laspy.copc.load_octree_for_query(reader.source, reader.copc_info, reader.root_page)
    low, high = XYZ.min(axis=0), np.where([True, False, False], XYZ.min(axis=0) + 20, XYZ.max(axis=0))
    box, data = laspy.copc.Bounds(low, high), bytearray(copc.read_bytes())
    far = [node for node in nodes if node.point_count and not node.bounds.overlaps(box)]
    assert 2 * len(far) > len(nodes)
    for node in far:
        data[node.offset : node.offset + node.byte_size] = bytes(node.byte_size)
    (tmp_path / "holes.laz").write_bytes(data)
    expected, found = (read_region(path, low, high) for path in (copc, tmp_path / "holes.laz"))
    assert len(found.row) > 50
    np.testing.assert_array_equal(found.xyz_mm, expected.xyz_mm)


def test_what_is_no_copc_is_not_taken_for_one(copc, tmp_path):
    assert is_copc(copc)
    write_points(tmp_path / "a.laz", XYZ)
    write_points(tmp_path / "a.ply", XYZ)
    assert not any(is_copc(tmp_path / name) for name in ("a.laz", "a.ply", "missing.laz"))
    with pytest.raises(PointFileError, match="is damaged or truncated"):
        read_region(tmp_path / "a.laz", np.zeros(3), np.ones(3))


@pytest.mark.parametrize("damage", ["cut off", "hierarchy of zeros", "a node too few"])
def test_a_damaged_hierarchy_is_told(copc, tmp_path, damage):
    data = bytearray(copc.read_bytes())
    with laspy.CopcReader.open(copc) as reader:
        at, size = reader.copc_info.hierarchy_root_offset, reader.copc_info.hierarchy_root_size
    match damage:
        case "cut off":
            del data[at + 8 :]
        case "hierarchy of zeros":
            data[at : at + size] = bytes(size)
        case "a node too few":
            second = int.from_bytes(data[235:243], "little") + 60 + 32  # of the nodes in the record
            data[second : second + 4] = (40).to_bytes(4, "little")  # a level that no child is on
    path = tmp_path / "a.laz"
    path.write_bytes(data)
    with pytest.raises(PointFileError, match="damaged"):
        read_region(path, np.full(3, -np.inf), np.full(3, np.inf))


def test_withheld_points_are_told_where_they_would_shift_rows(tmp_path):
    path = tmp_path / "a.copc.laz"
    write_copc(path, XYZ, withheld=[7])
    assert read_points(path).dropped == 1
    with pytest.raises(PointFileError, match="holds withheld points"):
        read_region(path, np.full(3, -np.inf), np.full(3, np.inf))


def test_coordinates_that_are_left_out_elsewhere_are_told(copc, tmp_path):
    data = bytearray(copc.read_bytes())
    data[131:139] = np.array(1e300).tobytes()  # the scale of x
    path = tmp_path / "a.copc.laz"
    path.write_bytes(data)
    with pytest.raises(PointFileError, match="holds coordinates that `read_points` leaves out"):
        read_region(path, np.full(3, -np.inf), np.full(3, np.inf))
