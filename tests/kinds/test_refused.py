"""Files that others read and that were once refused; and beside each, what is truly broken and still is."""

import gzip
import struct

import numpy as np
import pytest

from cablejax.io import PointFileError, iter_points, read_points, write_points
from tests.io.clouds import COLOR, INTENSITY, XYZ
from tests.io.test_points import pcd, ply
from tests.kinds.test_wrong_data import save

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.5], [-7.0, 8.0, 9.0]])
ROWS = "1 2 3\n4 5 6.5\n-7 8 9\n"
LITTLE, BIG = "binary_little_endian", "binary_big_endian"
AXES = "float x,float y,float z"


def record(order: str, *parts: tuple[str, object]) -> bytes:
    return b"".join(struct.pack(order + code, value) for code, value in parts)


def listed(order: str, lengths=(0, 2, 5)) -> bytes:
    """Vertices with a list between y and z, and a scalar behind."""
    return b"".join(
        record(order, ("f", x), ("f", y), ("B", n), *[("h", 7)] * n, ("f", z), ("B", 9))
        for (x, y, z), n in zip(POINTS, lengths, strict=True)
    )


LIST = "float x,float y,property list uchar short seen,float z,uchar flag".replace("property ", "")
FACES = "element face 2,property list uchar int vertex_indices"
FACE = {order: b"".join(record(order, ("B", n), *[("i", 0)] * n) for n in (3, 4)) for order in "<>"}
F4, B4 = POINTS.astype("<f4").tobytes(), POINTS.astype(">f4").tobytes()


def ply3(body: bytes, form: str = "ascii", properties: str = AXES, **more: str) -> bytes:
    return ply(body, form=form, vertices=3, properties=properties, **more)


def pcd3(body: bytes, fields: str = "x y z", size: str = "4 4 4", kind: str = "F F F", **more: str) -> bytes:
    return pcd(body, n=3, fields=fields, size=size, kind=kind, **more)


FIVE = "1 2 3 0 1\n4 5 6.5 0 1\n-7 8 9 0 1\n"
ONE = "element face 1,property list {} int v"
POSE = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1\t0 0\n0 0 1  0\n0 0 0 1\n"
READ = {
    # PLY: lists in and before the vertices
    "ply/list in ascii vertices": ("a.ply", ply3(b"1 2 0 3 9\n4 5 2 7 7 6.5 9\n-7 8 5 7 7 7 7 7 9 9\n", properties=LIST)),
    "ply/list in little vertices": ("a.ply", ply3(listed("<"), LITTLE, properties=LIST)),
    "ply/list in big vertices": ("a.ply", ply3(listed(">"), BIG, properties=LIST)),
    "ply/equal lists in vertices": ("a.ply", ply3(listed("<", (3, 3, 3)), LITTLE, properties=LIST)),
    "ply/list and faces": ("a.ply", ply3(listed("<") + FACE["<"], LITTLE, properties=LIST, after=FACES)),
    "ply/faces before ascii": ("a.ply", ply3(b"3 0 1 2\n4 0 1 2 0\n" + ROWS.encode(), before=FACES)),
    "ply/faces before little": ("a.ply", ply3(FACE["<"] + F4, LITTLE, before=FACES)),
    "ply/faces before big": ("a.ply", ply3(FACE[">"] + B4, BIG, before=FACES)),
    "ply/faces before, gzipped": ("a.ply.gz", gzip.compress(ply3(FACE["<"] + F4, LITTLE, before=FACES))),
    "ply/twice the same scalar": ("a.ply", ply3(FIVE.encode(), properties=AXES + ",float s,float s")),
    "ply/upper-case names": ("a.ply", ply3(ROWS.encode(), properties=AXES.replace("x", "X").replace("z", "Z"))),
    # padding
    "ply/zeros behind": ("a.ply", ply3(F4 + b"\0" * 400, LITTLE)),
    "ply/a line end behind": ("a.ply", ply3(F4 + b"\r\n" * 20, LITTLE)),
    "ply/zeros behind lists": ("a.ply", ply3(listed("<") + b"\0" * 400, LITTLE, properties=LIST)),
    "ply/zeros behind ascii": ("a.ply", ply3(ROWS.encode() + b"\0" * 400)),
    "ply/blank lines between ascii": ("a.ply", ply3(ROWS.replace("\n", "\n\n").encode() + b"\n \n")),
    "pcd/zeros behind": ("a.pcd", pcd3(F4 + b"\0" * 400, data="binary")),
    "pcd/zeros behind ascii": ("a.pcd", pcd3(ROWS.encode() + b"\0" * 400)),
    "pts/zeros behind": ("a.pts", f"3\n{ROWS}".encode() + b"\0" * 400),
    "ptx/zeros behind": ("a.ptx", f"3\n1\n{POSE}{ROWS}".encode() + b"\0" * 9),
    "xyz/zeros behind": ("a.xyz", ROWS.encode() + b"\0" * 400),
    "xyz/the end mark of CP/M": ("a.xyz", ROWS.encode() + b"\x1a"),
    "obj/zeros behind": ("a.obj", ("v " + ROWS.strip().replace("\n", "\nv ") + "\n").encode() + b"\0" * 9),
    # PCD headers
    "pcd/COUNT 0, ascii": ("a.pcd", pcd3(ROWS.encode(), "x y none z", "4 4 4 4", "F F F F", extra="COUNT 1 1 0 1\n")),
    "pcd/COUNT 0, binary": (
        "a.pcd", pcd3(F4, "x y z none", "4 4 4 1", "F F F U", extra="COUNT 1 1 1 0\n", data="binary")
    ),
    "pcd/padding, ascii": (
        "a.pcd",
        pcd3(b"1 2 0 0 3 0\n4 5 0 0 6.5 0\n-7 8 nan 0 9 -1\n", "x y _ z _", "4 4 1 4 4", "F F U F U", extra="COUNT 1 1 2 1 1\n"),
    ),
    "pcd/padding of 3 bytes": (
        "a.pcd",
        pcd3(b"".join(row.tobytes() + b"\7\7\7" for row in POINTS.astype("<f4")), "x y z _", "4 4 4 3", "F F F U", data="binary"),
    ),
    "pcd/upper-case fields": ("a.pcd", pcd3(ROWS.encode(), "X Y Z")),
    "pcd/upper-case fields, binary": ("a.pcd", pcd3(F4, "X Y Z", data="binary")),
    "pcd/lower-case types": ("a.pcd", pcd3(ROWS.encode(), kind="f f f")),
    "pcd/lower-case keywords": ("a.pcd", pcd3(ROWS.encode()).replace(b"FIELDS", b"fields").replace(b"DATA", b"data")),
    "pcd/upper-case storage": ("a.pcd", pcd3(ROWS.encode(), data="ASCII")),
    "pcd/twice the same field": ("a.pcd", pcd3(FIVE.encode(), "x y z s s", "4 4 4 4 4", "F F F F F")),
    # PTS with comments and headers
    "pts/comment first": ("a.pts", f"// made by hand\n3\n{ROWS}"),
    "pts/names, then the count": ("a.pts", f"//X Y Z\n3\n{ROWS}"),
    "pts/the count, then names": ("a.pts", f"3\n//X Y Z\n{ROWS}"),
    "pts/names without a mark": ("a.pts", f"X Y Z\n3\n{ROWS}"),
    "pts/the count, then such names": ("a.pts", f"3\nX Y Z\n{ROWS}"),
    "pts/names in another order": ("a.pts", "//Z,Y,X\n3\n3,2,1\n6.5,5,4\n9,8,-7\n"),
    "pts/comments between": ("a.pts", "# a\n2\n1 2 3\n# b\n4 5 6.5\n# c\n1\n-7 8 9\n"),
    "pts/blanks about the count": ("a.pts", f"  3 \t\n{ROWS}"),
    "xyz/a count first": ("a.xyz", f"3\n{ROWS}"),
    "asc/names and a count": ("a.asc", f"//X Y Z\n3\n{ROWS}"),
    "ptx/comment first": ("a.ptx", f"# by hand\n3\n1\n{POSE}{ROWS}"),
    # text headers
    **{
        f"txt/header {header.strip()!r}": ("a.txt", f"{header}\n{ROWS}")
        for header in ("# x y z", "#x y z", "% x y z", "%X Y Z", "## x y z", "// x, y, z", "# x\ty\tz", "x[mm] y[mm] z[mm]",
                       "x_mm y_mm z_mm", "X (mm)  Y (mm)  Z (mm)", "# x [mm], y [mm], z [mm]", '"x" "y" "z"', "x.mm y.mm z.mm",
                       "# made in 2024\n# x y z\n# unit mm", "easting northing elevation", "pos_x pos_y pos_z")
    },
    "csv/units and tabs": ("a.csv", "X [mm]\tY [mm]\tZ [mm]\n" + ROWS.replace(" ", "\t")),
    "csv/names end with a comma": ("a.csv", "x,y,z,\n" + ROWS.replace(" ", ",")),
    "csv/rows end with a comma": ("a.csv", "x,y,z\n" + ROWS.replace(" ", ",").replace("\n", ",\n")),
    "csv/pandas' index": ("a.csv", ",x,y,z\n0,1,2,3\n1,4,5,6.5\n2,-7,8,9\n"),
    "xyz/comment behind the numbers": ("a.xyz", "1 2 3 # first\n4 5 6.5 // second\n-7 8 9\n"),
    "txt/decimal commas and tabs": ("a.txt", "1,0\t2,0\t3,0\n4,0\t5,0\t6,5\n-7,0\t8,0\t9,0\n"),
    "txt/decimal commas and blanks": ("a.txt", "1,0 2,0 3,0\n4,0 5,0 6,5\n-7,0 8,0 9,0\n"),
}  # fmt: skip
# Blanks and tabs between numbers, in every text format.
SPACED = {
    "several blanks": ROWS.replace(" ", "   "),
    "several tabs": ROWS.replace(" ", "\t\t"),
    "mixed": "1 \t2\t 3\n4\t5  6.5\n-7  8\t\t9\n",
    "tabs, then blanks": "1\t2\t3\n4 5 6.5\n-7\t8 9\n",
    "blanks about": "  1 2 3  \n\t4 5 6.5\t\n -7 8 9 \n",
    "line ends of DOS": ROWS.replace("\n", "\r\n"),
}
TEXT = {
    "ply": lambda body: ply3(body.encode()),
    "pcd": lambda body: pcd3(body.encode()),
    "xyz": lambda body: body,
    "csv": lambda body: body,
    "pts": lambda body: f"3\n{body}",
    "ptx": lambda body: f"3\n1\n{POSE}{body}",
    "obj": lambda body: "".join(f"v {line}\n" for line in body.splitlines()),
}
READ |= {
    f"{ending}/{kind}": (f"a.{ending}", wrap(body)) for ending, wrap in TEXT.items() for kind, body in SPACED.items()
}


@pytest.mark.parametrize("kind", READ)
def test_read_without_a_word(tmp_path, kind):
    name, content = READ[kind]
    path = save(tmp_path, name, content)
    scan = read_points(path)
    assert np.array_equal(scan.xyz_mm, POINTS)
    assert (scan.dropped, scan.color) == (0, None)
    pieces = [piece.xyz_mm for piece in iter_points(path, chunk=2)]
    assert np.array_equal(np.concatenate(pieces), POINTS)


NANS = [
    "1.#QNAN",
    "-1.#IND",
    "-1.#IND00",
    "1.#INF",
    "-1.#INF000",
    "1.#SNAN",
    "nan(ind)",
    "-nan(ind)",
    "nan(snan)",
    "-nan",
    "NaN",
    "INF",
]


@pytest.mark.parametrize("ending", TEXT)
@pytest.mark.parametrize("nan", NANS)
def test_spellings_of_nan(tmp_path, nan, ending):
    first_or_second = f"{nan} {nan} {nan}\n1 2 3\n4 {nan} 6\n", f"1 2 3\n{nan} {nan} {nan}\n4 {nan} 6\n"
    for body in first_or_second:
        scan = read_points(save(tmp_path, f"a.{ending}", TEXT[ending](body)))
        assert (scan.xyz_mm.tolist(), scan.dropped) == ([[1, 2, 3]], 2)


# --- colours that are none never cost a coordinate ---

RGB = f"{AXES},uchar red,uchar green,uchar blue"
SIX = "1 2 3 {0} 0 7\n4 5 6.5 0 0 0\n-7 8 9 1 1 1\n"
SEVEN = "1 2 3 5 {0} 0 7\n4 5 6.5 5 0 0 0\n-7 8 9 5 1 1 1\n"


def doubles(color: str) -> bytes:
    return np.array([*POINTS[0], float(color), 0, 7, *POINTS[1], 0, 0, 0, *POINTS[2], 1, 1, 1], "<f8").tobytes()


WITH_COLOR = {
    "ply/ascii": ("a.ply", lambda c: ply3(SIX.format(c).encode(), properties=RGB)),
    "ply/ascii real": ("a.ply", lambda c: ply3(SIX.format(c).encode(), properties=RGB.replace("uchar", "float"))),
    "ply/binary real": (
        "a.ply", lambda c: ply3(doubles(c), LITTLE, RGB.replace("uchar", "double").replace("float", "double"))
    ),
    "pcd/rgb": (
        "a.pcd", lambda c: pcd3(f"1 2 3 {c}\n4 5 6.5 0\n-7 8 9 1\n".encode(), "x y z rgb", "4 4 4 4", "F F F U")
    ),
    "pcd/r g b": ("a.pcd", lambda c: pcd3(SIX.format(c).encode(), "x y z r g b", "4 4 4 1 1 1", "F F F U U U")),
    "csv": ("a.csv", lambda c: "x,y,z,r,g,b\n" + SIX.format(c).replace(" ", ",")),
    "xyz": ("a.xyz", SIX.format),
    "pts": ("a.pts", lambda c: "3\n" + SEVEN.format(c)),
    "ptx": ("a.ptx", lambda c: TEXT["ptx"](SEVEN.format(c))),
    "obj": ("a.obj", lambda c: TEXT["obj"](SIX.format(c))),
}  # fmt: skip


@pytest.mark.parametrize("color", ["nan", "-1", "1e10"])
@pytest.mark.parametrize("kind", WITH_COLOR)
def test_a_bad_colour_costs_no_coordinate(tmp_path, kind, color):
    name, make = WITH_COLOR[kind]
    with pytest.warns(UserWarning, match="left out"):
        scan = read_points(save(tmp_path, name, make(color)))
    assert np.array_equal(scan.xyz_mm, POINTS)
    assert scan.color is None


# --- a last point that is missing ---


def last_missing(tmp_path, ending):
    path = tmp_path / f"a.{ending.split()[0]}"
    if ending == "las":
        write_points(path, XYZ, color=COLOR, intensity=INTENSITY)
        size = 36  # bytes of a record of format 7
        path.write_bytes(path.read_bytes()[:-size])
        return path
    if "ascii" in ending or ending in ("pts", "ptx"):
        return save(tmp_path, path.name, TEXT[ending.split()[0]](ROWS.rsplit("-7", 1)[0]))
    write_points(path, XYZ)
    path.write_bytes(path.read_bytes()[: -12 if ending == "pcd" else -24])
    return path


SHORT = ["las", "ply", "ply ascii", "pcd", "pcd ascii", "pts", "ptx"]


@pytest.mark.parametrize("ending", SHORT)
def test_one_point_short_is_read_with_a_warning(tmp_path, ending):
    path = last_missing(tmp_path, ending)
    with pytest.warns(UserWarning, match="promises 3 points, 2 are there and were read"):
        assert len(read_points(path).xyz_mm) == 2
    with pytest.warns(UserWarning, match="promises 3 points, 2 are there and were read"):
        assert sum(len(piece.xyz_mm) for piece in iter_points(path, chunk=1)) == 2


@pytest.mark.parametrize("ending", SHORT)
def test_a_broken_last_point_is_still_an_error(tmp_path, ending):
    path = last_missing(tmp_path, ending)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(PointFileError):
        read_points(path)


# --- broken all the same ---

BROKEN = {
    "ply/list longer than the file": ("a.ply", ply3(listed("<")[:-2], LITTLE, properties=LIST), "truncated"),
    "ply/faces cut": ("a.ply", ply3((FACE["<"] + F4)[:-30], LITTLE, before=FACES), "truncated"),
    "ply/a huge list": ("a.ply", ply3(record("<", ("I", 2**32 - 1)) + F4, LITTLE, before=ONE.format("uint")), "truncated"),
    "ply/list of negative length": ("a.ply", ply3(record("<", ("i", -5)) + F4, LITTLE, before=ONE.format("int")), "length -5"),
    "ply/more faces than bytes": ("a.ply", ply3(F4, LITTLE, before=ONE.format("uchar").replace("1", "9" * 11)), "truncated"),
    "ply/ascii list too short": ("a.ply", ply3(b"1 2 2 7 3 9\n" * 3, properties=LIST), "expected"),
    "ply/ascii list without length": ("a.ply", ply3(b"1 2 x 3 9\n" * 3, properties=LIST), "length of the list"),
    "ply/numbers behind": ("a.ply", ply3(F4 + b"\1" * 40, LITTLE), "bytes more"),
    "ply/numbers behind lists": ("a.ply", ply3(listed("<") + b"\1" * 40, LITTLE, properties=LIST), "bytes more"),
    "pcd/numbers behind": ("a.pcd", pcd3(F4 + b"\1" * 40, data="binary"), "bytes more"),
    "pcd/COUNT 0 of x": ("a.pcd", pcd3(ROWS.encode(), extra="COUNT 0 1 1\n"), "no fields x, y and z"),
    "pcd/negative COUNT": ("a.pcd", pcd3(ROWS.encode(), extra="COUNT -1 1 1\n"), "damaged PCD header"),
    "pts/words within": ("a.pts", f"4\n{ROWS}one two three\n", "could not convert"),
    "csv/words within": ("a.csv", f"x y z\n{ROWS}one two three\n", "could not convert"),
    "pts/a count of 5,000 digits": ("a.pts", "9" * 5000 + f"\n{ROWS}", "damaged"),
    "ply/a list of 5,000 digits": ("a.ply", ply3(b"1 2 " + b"9" * 5000 + b" 3 9\n" * 3, properties=LIST), "promises 3|length"),
    "xyz/a number of a million digits": ("a.xyz", "1" * 10**6 + "x 2 3\n", "holds neither numbers"),
    "xyz/a name of underscores": ("a.xyz", "x y z" + "_" * 10**6 + f"\n{ROWS}", "holds neither numbers"),
    "xyz/brackets that never close": ("a.xyz", "x[" * 10**5 + f"\n{ROWS}", "holds neither numbers"),
    "csv/a quote that never ends": ("a.csv", 'x,y,z,"n\n1,2,3,"' + "a" * 200_000 + "\n", "damaged|columns"),
    "csv/a cell beyond csv's limit": ("a.csv", "x,y,z,n\n1,2,3," + "a" * 200_000 + "\n", "field larger"),
    "csv/a row too short": ("a.csv", "x,y,z\n1,2,3\n4,5\n", "cells|columns"),
    "tabs/a row too short": ("a.txt", "x\ty\tz\n1\t2\t3\n4\t5\n", "cells|columns"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_truly_broken_is_still_refused(tmp_path, kind):
    name, content, words = BROKEN[kind]
    with pytest.raises(PointFileError, match=words):
        read_points(save(tmp_path, name, content))
