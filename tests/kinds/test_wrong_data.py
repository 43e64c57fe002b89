"""Files and arrays that were once read as something else without a word."""

import numpy as np
import pytest

from cablejax import PointCloud, capacity_for
from cablejax.cli import main
from cablejax.io import PointFileError, iter_points, read_points, write_points
from tests.io.clouds import PTX_ROWS, PTX_SCAN
from tests.io.test_points import pcd, ply

N = 40
RNG = np.random.default_rng(0)
XYZ = np.round(RNG.normal(scale=30.0, size=(N, 3)), 3)
CELLS = np.stack(np.divmod(np.arange(N), 8), axis=1)
COLOR = RNG.integers(0, 256, (N, 3))
NORMALS = np.round((v := RNG.normal(size=(N, 3))) / np.linalg.norm(v, axis=1, keepdims=True), 4)


def rows(*columns, delimiter=" ") -> str:
    table = np.column_stack([np.asarray(column, float) for column in columns])
    return "".join(delimiter.join(f"{value:.10g}" for value in row) + "\n" for row in table)


def save(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# What stands in front of x, y, z, how the file is told, and what the columns are called.
SORTED = XYZ[np.argsort(XYZ[:, 0])]
IN_FRONT = {
    "index from 0": (rows(np.arange(N), XYZ), "count up", "index,x,y,z"),
    "index from 1": (rows(np.arange(1, N + 1), XYZ), "count up", "index,x,y,z"),
    "index with gaps": (rows(np.arange(N) * 3 + 17, XYZ), "count up", "id,x,y,z"),
    "index, then intensity": (rows(np.arange(N), XYZ, RNG.uniform(size=N)), "count up", "index,x,y,z,intensity"),
    "index, then colours": (rows(np.arange(N), XYZ, COLOR), "count up", "index,x,y,z,red,green,blue"),
    "index of a plane": (rows(np.arange(N), XYZ[:, :2], np.zeros(N)), "count up", "index,x,y,z"),
    "seconds of the day": (rows(40_000 + 0.005 * np.arange(N), XYZ), "never falls", "time,x,y,z"),
    "Unix time": (rows(1.7e9 + 0.25 * np.arange(N), XYZ), "never falls", "time,x,y,z"),
    "time of a profile": (rows(0.5 * (np.arange(N) // 8), XYZ), "never falls", "time,x,y,z"),
    "time, then intensity": (rows(0.1 * np.arange(N), XYZ, COLOR[:, 0]), "never falls", "time,x,y,z,intensity"),
    "row and column": (rows(CELLS, XYZ), "rows and columns", "row,column,x,y,z"),
    "column and row": (rows(CELLS[:, ::-1], XYZ), "rows and columns", "column,row,x,y,z"),
    "row, column, intensity behind": (rows(CELLS, XYZ, COLOR[:, 0]), "rows and columns", "row,column,x,y,z,intensity"),
}
ENDINGS = ["xyz", "txt", "csv", "asc", "pts"]


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("kind", IN_FRONT)
def test_first_columns_that_are_no_coordinates(tmp_path, kind, ending):
    text, words, columns = IN_FRONT[kind]
    path = save(tmp_path, f"a.{ending}", text.replace(" ", ",") if ending == "csv" else text)
    with pytest.raises(PointFileError, match=f"without column names, and .*{words}.*--columns"):
        read_points(path)
    expected = XYZ * (1, 1, 0) if kind == "index of a plane" else XYZ
    assert np.array_equal(read_points(path, columns=columns).xyz_mm, expected)
    pieces = [piece.xyz_mm for piece in iter_points(path, columns=columns.split(","), chunk=7)]
    assert np.array_equal(np.concatenate(pieces), expected)


PLAIN = {
    "coordinates alone": rows(XYZ),
    "a profile of whole steps": rows(np.arange(N), XYZ[:, :2]),  # three columns: nothing else can be x, y, z
    "intensity": rows(XYZ, COLOR[:, 0]),
    "sorted, with whole intensity": rows(SORTED, COLOR[:, 0]),
    "sorted, with normals": rows(SORTED, NORMALS),
    "sorted, with colours": rows(SORTED, COLOR),
    "a depth map with colours": rows(CELLS, XYZ[:, 2], COLOR),
    "a depth map with normals": rows(CELLS, XYZ[:, 2], NORMALS),
    "a lattice with intensity": rows(CELLS, CELLS[:, 0], COLOR[:, 0]),
}


@pytest.mark.parametrize("kind", PLAIN)
def test_tables_that_begin_with_coordinates_are_read(tmp_path, kind):
    text = PLAIN[kind]
    expected = np.array([line.split()[:3] for line in text.splitlines()], float)
    assert np.array_equal(read_points(save(tmp_path, "a.xyz", text)).xyz_mm, expected)


@pytest.mark.parametrize("command", ["info", "measure", "report", "denoise", "register", "classify"])
def test_every_command_that_reads_scans_takes_columns(tmp_path, capsys, command):
    path = save(tmp_path, "a.xyz", "1 0 0 0\n2 0 0 0\n3 0 0 0\n")
    more = {
        "report": ["r.html"],
        "denoise": [str(tmp_path / "b.ply")],
        "register": [str(path)],
        "classify": ["--checkpoint", str(tmp_path)],
    }
    (tmp_path / "run.json").write_text('{"config": {"model": {}, "dataset": {}}, "metrics": {"labels_mm2": []}}')
    arguments = [command, str(path), *more.get(command, []), "--unit", "mm", "--quiet"]
    assert main(arguments) == 1
    assert "--columns index,x,y,z" in capsys.readouterr().err
    assert main([*arguments, "--columns", "index,x,y,z"]) == 1
    assert "all 3 points are at the origin" in capsys.readouterr().err
    assert main([*arguments, "--columns", "index,x,y"]) == 1
    assert "--columns: expected x, y and z once each" in capsys.readouterr().err


def test_tiled_denoise_takes_columns(tmp_path, capsys):
    path = save(tmp_path, "a.xyz", rows(np.arange(N), XYZ))
    arguments = ["denoise", str(path), str(tmp_path / "b.ply"), "--unit", "mm", "--tile", "5", "--neighbors", "4"]
    assert main(arguments) == 1
    assert "--columns" in capsys.readouterr().err
    assert main([*arguments, "--columns", "index,x,y,z"]) == 1
    assert "tile_points: expected at least" in capsys.readouterr().err  # it was read


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("x,y,intensty,z", "columns: expected names among x, y, z, .* got 'intensty'"),
        ("x,y", "columns: expected x, y and z once each"),
        ("x,y,z,x", "columns: expected x, y and z once each"),
        ("x,y,z,i,intensity", "others at most once"),
        ("", "columns: expected names among"),
    ],
)
def test_columns_that_make_no_sense(tmp_path, columns, words):
    with pytest.raises(ValueError, match=words):
        read_points(save(tmp_path, "a.xyz", rows(XYZ)), columns=columns)


def test_columns_must_fit_the_file(tmp_path):
    with pytest.raises(PointFileError, match="has 3 numbers a row, expected 4"):
        read_points(save(tmp_path, "a.xyz", rows(XYZ)), columns="index,x,y,z")
    with pytest.raises(PointFileError, match="names its columns itself, being PLY"):
        read_points(save(tmp_path, "a.ply", ply(b"1 2 3\n")), columns="z,y,x")


def test_columns_overrule_a_header_and_skip_words(tmp_path):
    path = save(tmp_path, "a.csv", "a,b,c,d\ncable,3,2,1\ntray,6,5,4\n")
    assert read_points(path, columns="skip,z,y,x").xyz_mm.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("header", ["# x y z", "x y z", '"x" "y" "z"'])
def test_a_header_that_names_fewer_columns_is_not_believed(tmp_path, header):
    """A table of R has row names without a name; prose may hold x, y and z by chance."""
    with pytest.raises(PointFileError, match="--columns"):
        read_points(save(tmp_path, "a.txt", f"{header}\n{rows(np.arange(1, N + 1), XYZ)}"))
    prose = f"# units: {header.strip('# ')} in mm\n{rows(XYZ)}"
    assert np.array_equal(read_points(save(tmp_path, "a.txt", prose)).xyz_mm, XYZ)


# --- colours ---

RED = [[255, 0, 128]] * 2
SHARES = "float x,float y,float z,float red,float green,float blue"
COLORS = {
    "shares beyond 1 by rounding": ("a.obj", "v 1 2 3 1.0000001 0 0.5\nv 4 5 6 1 -1e-9 0.5\n"),
    "the same in a table": ("a.csv", "x,y,z,r,g,b\n1,2,3,1.0000001,0,0.5\n4,5,6,1,0,0.5\n"),
    "the same in PLY": ("a.ply", ply(b"1 2 3 1.0000001 0 0.5\n4 5 6 1 -1e-9 0.5\n", vertices=2, properties=SHARES)),
    "the same in binary PLY": (
        "a.ply",
        ply(
            np.array([1, 2, 3, 1 + 2e-7, 0, 0.5] * 2, "<f4").tobytes(),
            form="binary_little_endian",
            vertices=2,
            properties=SHARES,
        ),
    ),
    "the same in PCD": (
        "a.pcd",
        pcd(
            b"1 2 3 1.0000001 0 0.5\n4 5 6 1 0 0.5\n", n=2, fields="x y z r g b", size="4 4 4 4 4 4", kind="F F F F F F"
        ),
    ),
    "the same in PTX": ("a.ptx", PTX_SCAN.replace("2\n2\n", "1\n2\n", 1) + "1 2 3 0 1.0000001 0 0.5\n" * 2),
    "colours of no point": ("a.csv", "x,y,z,r,g,b\n1,2,3,255,0,128\nnan,0,0,nan,-1,1e9\n4,5,6,255,0,128\n"),
    "behind a weight": ("a.obj", "v 1 2 3 1 1 0 0.5\nv 1 2 3 1 1.0 0 0.5\n"),
}


@pytest.mark.parametrize("kind", COLORS)
def test_colours_keep_their_scale(tmp_path, kind):
    name, content = COLORS[kind]
    scan = read_points(save(tmp_path, name, content))
    assert (len(scan.xyz_mm), scan.color.dtype, scan.color.tolist()) == (2, np.uint8, RED)


def test_pure_colours_of_real_numbers_are_shares(tmp_path):
    for name, content in (
        ("a.ply", ply(b"1 2 3 1 0 1\n", properties=SHARES)),
        ("a.obj", "v 1 2 3 1 0 1\n"),
    ):
        assert read_points(save(tmp_path, name, content)).color.tolist() == [[255, 0, 255]]


BEHIND = {
    "an index": (rows(XYZ, np.arange(N)), None, None),
    "classes and returns": (rows(XYZ, COLOR % 4), None, None),
    "two numbers": (rows(XYZ, COLOR[:, :2]), None, None),
    "shares that are no normals": (rows(XYZ, COLOR / 255), None, None),
    "five numbers": (rows(XYZ, COLOR, COLOR[:, :2]), None, None),
    "colours or intensity first": (rows(XYZ, COLOR, COLOR[:, :1]), COLOR, COLOR[:, 0]),
}


@pytest.mark.parametrize("kind", BEHIND)
def test_numbers_behind_the_coordinates_are_not_guessed(tmp_path, kind):
    text, color, intensity = BEHIND[kind]
    with pytest.warns(UserWarning, match="--columns"):
        scan = read_points(save(tmp_path, "a.xyz", text))
    assert np.array_equal(scan.xyz_mm, XYZ)
    for found, expected in ((scan.color, color), (scan.intensity, intensity)):
        assert found is None if expected is None else np.array_equal(found, expected)


def test_numbers_behind_the_coordinates_without_doubt(tmp_path):
    for text in (rows(XYZ, COLOR, NORMALS), rows(XYZ, NORMALS, COLOR), rows(XYZ, COLOR)):
        assert np.array_equal(read_points(save(tmp_path, "a.xyz", text)).color, COLOR)
    scan = read_points(save(tmp_path, "a.xyz", rows(XYZ, COLOR, COLOR[:, 0] * 100)))
    assert np.array_equal(scan.intensity, COLOR[:, 0] * 100)


def test_seven_numbers_of_an_obj_vertex(tmp_path):
    alpha = save(tmp_path, "a.obj", "v 1 2 3 1 0 0.5 1\nv 4 5 6 0.2 1 0 1\n")
    assert read_points(alpha).color.tolist() == [[255, 0, 128], [51, 255, 0]]
    for neither_or_both in ("0.5 1 0 0.5", "1 1 0 1"):
        path = save(tmp_path, "b.obj", f"v 1 2 3 {neither_or_both}\n" * 2)
        with pytest.warns(UserWarning, match="its colours are left out"):
            assert read_points(path).color is None


# --- poses, returns, cells ---

IDENTITY = "1 0 0 0\n0 1 0 0\n0 0 1 0\n"
POSES = {
    "all zeros": "0 0 0 0\n" * 3 + "5 6 7 1\n",
    "a scale": "2 0 0 0\n0 2 0 0\n0 0 2 0\n5 6 7 1\n",
    "a mirror": "-1 0 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n",
    "a shear": "1 0.1 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n",
    "a projection": "1 0 0 0\n0 1 0 0\n0 0 0 0\n5 6 7 1\n",
    "a translation in the last column": "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n",
    "no number": "nan 0 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n",
}


@pytest.mark.parametrize("kind", POSES)
def test_a_pose_that_is_no_rotation_is_refused(tmp_path, kind):
    head = "".join(line + "\n" for line in PTX_SCAN.splitlines()[:6])
    with pytest.raises(PointFileError, match=r"pose|transformation"):
        read_points(save(tmp_path, "a.ptx", head + POSES[kind] + PTX_ROWS))
    rounded = head + "0.7071 0.7071 0 0\n-0.7071 0.7071 0 0\n0 0 1 0\n5 6 7 1\n" + PTX_ROWS
    assert len(read_points(save(tmp_path, "a.ptx", rounded)).xyz_mm) == 2


def write_e57(path, xyz, **more):
    import pye57

    with pye57.E57(str(path), mode="w") as file:
        data = {f"cartesian{axis}": column for axis, column in zip("XYZ", xyz.T, strict=True)}
        data |= more.pop("fields", {})
        file.write_scan_raw(data, **more)
    return path


def test_an_e57_pose_that_is_no_rotation_is_refused(tmp_path):
    turn = np.array([0.0, 0.0, 0.0, 0.0])
    path = write_e57(tmp_path / "a.e57", XYZ, rotation=turn, translation=np.array([5.0, 6, 7]))
    with pytest.raises(PointFileError, match="pose is off a rotation"):
        read_points(path, unit="m")


def test_beams_without_return_of_a_scanner_with_a_pose(tmp_path):
    xyz = np.concatenate([XYZ, np.zeros((5, 3))])
    path = write_e57(tmp_path / "a.e57", xyz, translation=np.array([5.0, 6, 7]))
    scan = read_points(path, unit="m")
    assert (len(scan.xyz_mm), scan.dropped) == (N, 5)
    assert np.allclose(scan.xyz_mm / 1000, XYZ + np.array([5, 6, 7]), atol=1e-4)
    one = write_e57(tmp_path / "b.e57", xyz[: N + 1])  # a single one may be a point
    assert len(read_points(one, unit="m").xyz_mm) == N + 1
    pieces = list(iter_points(path, unit="m", chunk=20))
    assert (sum(len(piece.xyz_mm) for piece in pieces), sum(piece.dropped for piece in pieces)) == (N, 5)


EMPTY = {
    "commas": "1,2,3,9\n,,,\n4,,6,9\n7,8,9,9\n",
    "commas, no more columns": "1,2,3\n,,\n4,,6\n7,8,9\n",
    "names": "x,y,z,intensity\n1,2,3,9\n,,,9\n4,5,,9\n7,8,9,9\n",
    "semicolons": "1;2;3;9\n;;;\n4;;6;9\n7;8;9;9\n",
    "tabs and names": "x\ty\tz\ti\n1\t2\t3\t9\n\t\t\t9\n4\t\t6\t9\n7\t8\t9\t9\n",
    "quotes": '"1","2","3","9"\n"","","",""\n"4","","6","9"\n"7","8","9","9"\n',
    "words": "1,2,3,9\nNA,NA,NA,NA\n4,null,6,9\n7,8,9,9\n",
    "words and blanks": "1 2 3 9\nNA NA NA NA\n4 N/A 6 9\n7 8 9 9\n",
}


@pytest.mark.parametrize("kind", EMPTY)
def test_empty_cells_are_invalid_returns(tmp_path, kind):
    scan = read_points(save(tmp_path, "a.csv", EMPTY[kind]))
    assert (scan.xyz_mm.tolist(), scan.dropped) == ([[1, 2, 3], [7, 8, 9]], 2)


def test_a_missing_intensity_costs_no_point(tmp_path):
    scan = read_points(save(tmp_path, "a.csv", "x,y,z,i\n1,2,3,9\n4,5,6,\n"))
    assert (scan.dropped, scan.intensity.tolist()[0], bool(np.isnan(scan.intensity[1]))) == (0, 9.0, True)


def test_integers_of_a_header_are_not_cut(tmp_path):
    with pytest.raises(PointFileError, match="x that is no i4 number"):
        read_points(save(tmp_path, "a.ply", ply(b"1.5 2 3\n", properties="int x,int y,int z")))
    with pytest.raises(PointFileError, match="x that does not fit its type int32"):
        read_points(save(tmp_path, "a.pcd", pcd(b"1.5 2 3\n", kind="I I I")))


def test_units_in_column_names_are_heeded(tmp_path):
    path = save(tmp_path, "a.csv", "x[m],y[m],z[m]\n1,2,3\n")
    assert read_points(path, unit=None).xyz_mm.tolist() == [[1000, 2000, 3000]]
    assert read_points(path, unit="m").xyz_mm.tolist() == [[1000, 2000, 3000]]
    with pytest.warns(UserWarning, match="it says itself that it is in m, and is read as mm as asked"):
        assert read_points(path).xyz_mm.tolist() == [[1, 2, 3]]
    assert read_points(save(tmp_path, "b.csv", "x,y,z\n1,2,3\n"), unit=None).xyz_mm.tolist() == [[1, 2, 3]]


# --- arrays ---

UTM = np.array([482_123.0, 5_412_345.0, 312.0])


@pytest.mark.parametrize("form", ["float64", "list", "integers"])
def test_coordinates_that_float32_would_spoil_are_refused(form):
    xyz = UTM + 0.01 * XYZ
    given = {"float64": xyz, "list": xyz.tolist(), "integers": np.round(xyz * 1e6).astype(np.int64)}[form]
    with pytest.raises(ValueError, match=r"xyz: expected coordinates near the origin, .* subtract a shift first"):
        PointCloud.from_xyz(given)
    shifted = np.asarray(given) - np.median(np.asarray(given), axis=0)
    assert PointCloud.from_xyz(shifted).mask.sum() == len(shifted)


def test_coordinates_that_float32_holds_are_taken_wherever_they_are():
    for xyz in (XYZ, XYZ + 1000, (XYZ + 1e6).astype(np.float32), np.round(XYZ) + 1e6, UTM[None], [[np.nan, 0, 0]]):
        assert PointCloud.from_xyz(xyz).mask.sum() == len(xyz)


def test_capacities_are_few(tmp_path):
    sizes = [capacity_for(n) for n in range(1, 5000)]
    assert all(n <= size < 1.125 * n + 1 for n, size in enumerate(sizes, 1))
    assert len({size for size in sizes if 1024 < size <= 4096}) == 16
    cloud = PointCloud.from_xyz(XYZ)
    assert (len(cloud.xyz), int(cloud.mask.sum())) == (capacity_for(N), N)
    write_points(tmp_path / "a.ply", XYZ)
    assert len(read_points(tmp_path / "a.ply").cloud().xyz) == capacity_for(N)
    assert len(PointCloud.from_xyz(XYZ, capacity=N).xyz) == N
