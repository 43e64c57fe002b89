"""Readers: every format, units, large coordinates, invalid returns, colours and intensity."""

import gzip
import os

import numpy as np
import pytest

from cablejax.io import PointFileError, read_points, write_points
from tests.io.clouds import COLOR, INTENSITY, PTX_ROWS, PTX_SCAN, XYZ, lzf_compress


def ply(body: bytes, *, form="ascii", vertices=1, properties="float x,float y,float z", before="", after="") -> bytes:
    lines = ["ply", f"format {form} 1.0", "comment made by hand", *before.split(",")]
    lines += [f"element vertex {vertices}", *(f"property {p}" for p in properties.split(",")), *after.split(",")]
    return "\n".join([line for line in lines if line] + ["end_header"]).encode() + b"\n" + body


def pcd(body: bytes, *, fields="x y z", size="4 4 4", kind="F F F", n=1, data="ascii", extra="") -> bytes:
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {kind}\n{extra}WIDTH {n}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {data}\n"
    ).encode() + body


def read(tmp_path, name, content, **options):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_points(path, **options)


ONE = np.array([[1.0, 2.0, 3.0]])
LITTLE, BIG = np.array([1, 2, 3], "<f4").tobytes(), np.array([1, 2, 3], ">f4").tobytes()
GOOD = {
    "ascii.ply": ply(b"1 2 3\n"),
    "little.ply": ply(LITTLE, form="binary_little_endian"),
    "big.ply": ply(BIG, form="binary_big_endian"),
    "double.ply": ply(np.array([3.0, 2, 1]).tobytes(), form="binary_little_endian", properties="double z,double y,double x"),
    "faces.ply": ply(LITTLE + b"\3\0\0\0\0", form="binary_little_endian", after="element face 1,property list uchar int i"),
    "camera.ply": ply(b"\7" + LITTLE, form="binary_little_endian", before="element camera 1,property uchar id"),
    "crlf.ply": ply(b"1 2 3\n").replace(b"\n", b"\r\n"),
    "ascii.pcd": pcd(b"1 2 3\n"),
    "binary.pcd": pcd(LITTLE, data="binary"),
    "padded.pcd": pcd(b"\0" * 3 + LITTLE + b"\0", fields="_ x y z _", size="1 4 4 4 1", kind="U F F F U",
                      extra="COUNT 3 1 1 1 1\n", data="binary"),
    "spaces.xyz": "1 2 3\n",
    "letters.txt": "# scanned in Ålesund\n1 2 3\n",  # Å ends in a byte that Python takes for a line end
    "tabs.txt": "# a comment\n\n1\t2\t3\n",
    "commas.csv": "1,2,3\n",
    "trailing.csv": "1,2,3,\n",
    "semicolons.csv": "1;2;3\n",
    "decimal.csv": "1,0;2,0;3,0\n",
    "names.csv": '"Z","note","Y","X"\n3,"a, b",2,1\n',
    "comment_names.txt": "//Z Y X\n3 2 1\n",
    "bom.csv": "\ufeffx,y,z\n1,2,3\n".encode(),
    "utf16.txt": "x y z\n1 2 3\n".encode("utf-16"),
    "normals.xyz": "1 2 3 0.0 0.6 0.8\n",
    "counted.pts": "1\n1 2 3\n",
    "uncounted.pts": "1 2 3\n",
    "mesh.obj": "# obj\nmtllib a.mtl\nv 1 2 3\nvn 0 0 1\nf 1 1 1\n",
    "weighted.obj": "v 1 2 3 1.0\n",
    "wrong_ending.txt": ply(b"1 2 3\n"),
    "no_ending": pcd(b"1 2 3\n"),
    "packed.xyz.gz": gzip.compress(b"1 2 3\n"),
    "packed.xyz": gzip.compress(b"1 2 3\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_one_point_of_every_dialect(tmp_path, name):
    scan = read(tmp_path, name, GOOD[name])
    assert np.array_equal(scan.xyz_mm, ONE)
    assert scan.xyz_mm.dtype == np.float64
    assert (scan.dropped, scan.color, scan.intensity) == (0, None, None)


FLOAT_COLOR = b"1 2 3 %r 12\n" % float(np.uint32(0xFF0007).view(np.float32))
COLORED = {
    "a.ply": ply(b"1 2 3 255 0 7 12\n", properties="float x,float y,float z,uchar red,uchar green,uchar blue,float intensity"),
    "scalar.ply": ply(b"1 2 3 255 0 7 12\n", properties="float x,float y,float z,uchar r,uchar g,uchar b,float scalar_Intensity"),
    "i_first.pts": "1\n1 2 3 12 255 0 7\n",
    "i_first.xyz": "1 2 3 -12 255 0 7\n",
    "named.csv": "Intensity;Red;Green;Blue;X;Y;Z\n12;255;0;7;1;2;3\n",
    "packed.pcd": pcd(b"1 2 3 16711687 12\n", fields="x y z rgb intensity", size="4 4 4 4 4", kind="F F F U F"),
    "float.pcd": pcd(FLOAT_COLOR, fields="x y z rgb intensity", size="4 4 4 4 4", kind="F F F F F"),
    "float_as_integer.pcd": pcd(b"1 2 3 4294901767 12\n", fields="x y z rgb intensity", size="4 4 4 4 4", kind="F F F F F"),
}  # fmt: skip


@pytest.mark.parametrize("name", COLORED)
def test_colors_and_intensity(tmp_path, name):
    scan = read(tmp_path, name, COLORED[name])
    assert np.array_equal(scan.xyz_mm, ONE)
    assert scan.color.dtype == np.uint8
    assert scan.color.tolist() == [[255, 0, 7]]
    assert scan.intensity.tolist() == [-12.0 if name == "i_first.xyz" else 12.0]


def test_obj_colors_are_shares(tmp_path):
    assert read(tmp_path, "a.obj", "v 1 2 3 1.0 0.0 0.5\n").color.tolist() == [[255, 0, 128]]


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1), ("cm", 10), ("m", 1000), ("in", 25.4), ("um", 1e-3)])
def test_units(tmp_path, unit, scale):
    assert np.array_equal(read(tmp_path, "a.xyz", "1 2 3\n", unit=unit).xyz_mm, ONE * scale)


def test_unknown_unit(tmp_path):
    with pytest.raises(ValueError, match=r"unit: expected one of um, mm, .* got 'parsec'"):
        read(tmp_path, "a.xyz", "1 2 3\n", unit="parsec")


def test_large_coordinates_are_shifted_before_float32(tmp_path):
    """UTM metres: in float32 the northing alone would be rounded to 0.5 m."""
    offset = np.array([[482_123.0, 5_412_345.0, 312.0]])
    local = np.random.default_rng(0).uniform(-0.05, 0.05, (100, 3))
    write_points(tmp_path / "utm.ply", (offset + local) * 1000)
    scan = read_points(tmp_path / "utm.ply")
    assert np.array_equal(scan.shift_mm, np.round(scan.shift_mm))
    xyz = np.asarray(scan.cloud().xyz, np.float64)[:100] + scan.shift_mm
    # Half a float32 step below 128 mm is 3.8e-6 mm; half a float64 step at 5.4e9 mm is 4.8e-7 mm.
    assert np.abs(xyz - (offset + local) * 1000).max() < 5e-6


def test_invalid_returns_are_dropped_and_counted(tmp_path):
    rows = "1 2 3 1\nnan 0 0 2\n0 inf 0 3\n3.4e38 0 0 4\n4 5 6 5\n"
    scan = read(tmp_path, "a.xyz", rows)
    assert (scan.xyz_mm.tolist(), scan.intensity.tolist(), scan.dropped) == ([[1, 2, 3], [4, 5, 6]], [1, 5], 3)
    assert bool(np.asarray(scan.cloud().mask).all())


def test_ptx_pose_and_empty_returns(tmp_path):
    scan = read(tmp_path, "a.ptx", PTX_SCAN + PTX_ROWS, unit="m")
    # Row vectors times a quarter turn about z, then the translation.
    assert np.allclose(scan.xyz_mm / 1000, [[-2 + 10, 1 + 20, 33], [-5 + 10, 4 + 20, 36]])
    assert scan.dropped == 2
    assert scan.color.tolist() == [[255, 0, 7], [1, 2, 3]]
    assert scan.intensity.tolist() == [0.5, 0.25]


def test_several_scans_in_a_file(tmp_path):
    assert len(read(tmp_path, "a.ptx", (PTX_SCAN + PTX_ROWS) * 2).xyz_mm) == 4
    assert len(read(tmp_path, "a.pts", "1\n1 2 3\n2\n4 5 6\n7 8 9\n").xyz_mm) == 3


def test_compressed_pcd_is_stored_field_by_field(tmp_path):
    columns = np.concatenate([XYZ[:, 0], XYZ[:, 1], XYZ[:, 2]]).astype("<f4").tobytes() + b"\7" * 600
    packed = lzf_compress(columns)
    sizes = np.array([len(packed), len(columns)], "<u4").tobytes()
    fields = {"fields": "x y z pad", "size": "4 4 4 1", "kind": "F F F U", "extra": "COUNT 1 1 1 200\n"}
    scan = read(tmp_path, "a.pcd", pcd(sizes + packed, n=3, data="binary_compressed", **fields))
    assert np.array_equal(scan.xyz_mm, XYZ.astype(np.float32))


@pytest.mark.parametrize("ending", ["ply", "pcd", "xyz", "txt", "csv", "las", "laz"])
@pytest.mark.parametrize("unit", ["mm", "m"])
def test_round_trip(tmp_path, ending, unit):
    path = tmp_path / f"a.{ending}"
    write_points(path, XYZ, unit=unit, color=COLOR, intensity=INTENSITY)
    scan = read_points(path, unit=unit)
    # LAS stores multiples of its step: 12,346 mm fit 32 bits in steps of 1e-5 mm, and no step is below 1e-6 m.
    step = {"mm": 1e-5, "m": 1e-3}[unit]
    # PCD holds float32: half a step at 12,346 is 4.9e-4.
    error = {"las": step / 2 * 1.001, "laz": step / 2 * 1.001, "pcd": 4.9e-4}.get(ending, 1e-11)
    assert np.abs(scan.xyz_mm - XYZ).max() <= error
    eight_bits = scan.color if scan.color.dtype == np.uint8 else scan.color // 257
    assert np.array_equal(eight_bits, COLOR)
    assert np.array_equal(scan.intensity, INTENSITY)


@pytest.mark.parametrize("ending", ["ply", "pcd", "csv", "laz"])
def test_intensity_that_is_no_integer_survives(tmp_path, ending):
    intensity = np.array([0.1, -3.5, 1e6], np.float32)
    write_points(tmp_path / f"a.{ending}", XYZ, intensity=intensity)
    scan = read_points(tmp_path / f"a.{ending}")
    assert np.array_equal(scan.intensity, intensity)
    assert scan.color is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"xyz_mm": np.zeros((0, 3))}, "xyz_mm: expected shape"),
        ({"xyz_mm": np.array([[np.nan, 0, 0]])}, "xyz_mm: expected finite"),
        ({"xyz_mm": XYZ, "color": COLOR.astype(float)}, "color: expected uint8"),
        ({"xyz_mm": XYZ, "unit": "ell"}, "unit: expected"),
    ],
)
def test_bad_arguments_write_nothing(tmp_path, arguments, words):
    with pytest.raises(ValueError, match=words):
        write_points(tmp_path / "a.ply", **arguments)
    assert os.listdir(tmp_path) == []


def test_unwritable_endings_and_folders(tmp_path):
    with pytest.raises(PointFileError, match=r"a\.e57: has an ending that cannot be written"):
        write_points(tmp_path / "a.e57", XYZ)
    with pytest.raises(PointFileError, match=r"a\.ply: cannot be written \(No such file"):
        write_points(tmp_path / "absent" / "a.ply", XYZ)


def test_pcd_is_read_by_open3d_and_refuses_what_float32_would_round(tmp_path):
    open3d = pytest.importorskip("cablejax.io").import_open3d()
    write_points(tmp_path / "a.pcd", XYZ, color=COLOR)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "a.pcd"))
    assert np.array_equal(np.asarray(cloud.points), XYZ.astype(np.float32))
    assert np.array_equal(np.round(np.asarray(cloud.colors) * 255), COLOR)
    with pytest.raises(PointFileError, match=r"a\.pcd: cannot be written: PCD readers take float32"):
        write_points(tmp_path / "a.pcd", XYZ + 5e9)
    assert len(read_points(tmp_path / "a.pcd").xyz_mm) == 3


def test_withheld_las_points_are_dropped(tmp_path):
    import laspy

    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.x, las.y, las.z = XYZ.T
    las.withheld = [0, 1, 0]
    las.write(str(tmp_path / "a.laz"))
    scan = read_points(tmp_path / "a.laz")
    assert (len(scan.xyz_mm), scan.dropped) == (2, 1)


def test_e57_invalid_states_poses_and_precision(tmp_path):
    import pye57

    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        data = {f"cartesian{axis}": np.array([1.0, 2.0, 3.0]) for axis in "XYZ"}
        data |= {"intensity": np.array([0.5, 0.25, 0.125]), "cartesianInvalidState": np.array([0, 2, 0], np.int8)}
        data |= {f"color{name}": np.array([255, 0, 7], np.uint8) for name in ("Red", "Green", "Blue")}
        file.write_scan_raw(data, translation=np.array([500_000.0, 5_000_000.0, 0.0625]))
    with pytest.warns(UserWarning, match=r"a\.e57: it says itself that it is in m, and is read as mm"):
        read_points(tmp_path / "a.e57")
    scan = read_points(tmp_path / "a.e57", unit="m")
    assert (scan.xyz_mm / 1000).tolist() == [[500_001, 5_000_001, 1.0625], [500_003, 5_000_003, 3.0625]]
    assert (scan.dropped, scan.intensity.tolist(), scan.color[:, 0].tolist()) == (1, [0.5, 0.125], [255, 7])


def test_real_files_hold_what_their_sources_say(data_dir):
    """Counts from the data's README, from laspy's tests, and from the headers read by eye."""
    counts = {
        "poles/pcl/lamppost.pcd": (1771, 0),
        "poles/pcl/table_scene_mug_stereo_textured.pcd": (209_280, 97_920),
        "poles/itsme/buttressed_tree_1_pc.txt.gz": (64_082, 0),
        "poles/itsme/pc_tree.las": (30_826, 0),
        "registration/small_gicp/source.ply": (69_792, 0),
        "registration/room_scan1.pcd": (112_586, 0),
        "parsers/laspy/tests/data/simple.copc.laz": (1065, 0),
        "parsers/e57/libE57Format-test-data/reference/bunnyInt32.e57": (30_571, 0),
    }
    for name, expected in counts.items():
        scan = read_points(data_dir / name, unit="m")
        assert (len(scan.xyz_mm), scan.dropped) == expected, name
