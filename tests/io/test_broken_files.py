"""Broken files: one clear sentence with path and reason; never a hang, a crash, an empty or a half-read cloud."""

import errno
import gzip
import io
import os
import sys

import numpy as np
import pytest

from cablejax.io import PointFileError, isolated, read_points, write_points
from cablejax.io.pcd import lzf_decompress
from cablejax.io.raw import BadFile, RawCloud
from cablejax.io.sinks import LasSink
from tests.io.clouds import COLOR, INTENSITY, PTX_ROWS, PTX_SCAN, XYZ

PLY = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
PCD = b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n"
LIST = PLY.replace(b"property float x", b"property list uchar float weight\nproperty float x")
PACKED_LIST = LIST.replace(b"ascii", b"binary_little_endian")
BROKEN = {
    "empty.ply": (b"", "is empty"),
    "empty.gz": (gzip.compress(b""), "is empty"),
    "a.docx": (b"PK\3\4", "has an unknown ending; known are .ply"),
    "no_ending": (b"1 2 3\n", "has an unknown ending"),
    "short.ply": (PLY.replace(b"vertex 2", b"vertex 3") + b"1 2 3\n", "truncated: its header promises 3 points, 1 are there"),
    "long.ply": (PLY + b"1 2 3\n" * 3, "holds more lines than the 2 points"),
    "binary.ply": (PLY.replace(b"ascii", b"binary_little_endian") + b"\0" * 23, "promises 2 points, 1 are there"),
    "extra.ply": (PLY.replace(b"ascii", b"binary_little_endian") + b"\1" * 36, "holds 12 bytes more than the 2 points"),
    "huge.ply": (PLY.replace(b"vertex 2", b"vertex 99999999999999999999"), "is truncated"),
    "header.ply": (PLY.replace(b"end_header", b"end"), "its header has no beginning or no end"),
    "plain.ply": (b"1 2 3\n", "is no PLY file"),
    "type.ply": (PLY.replace(b"float x", b"quaternion x"), "header line that means nothing: 'property quaternion x'"),
    "no_x.ply": (PLY.replace(b"float x", b"float u"), "has vertices without one x, y and z each"),
    "list.ply": (PLY.replace(b"float x", b"list uchar float x"), "without one x, y and z each"),
    "negative.ply": (PLY.replace(b"vertex 2", b"vertex -2"), "negative count"),
    "zero.ply": (PLY.replace(b"vertex 2", b"vertex 0"), "holds no point"),
    "none.ply": (PLY.replace(b"vertex", b"corner") + b"1 2 3\n" * 2, "has 0 vertex elements"),
    "twice.ply": (PLY.replace(b"end_header", PLY[21:]) + b"1 2 3\n" * 4, "has 2 vertex elements"),
    "line.ply": (PLY.replace(b"end_header", b"wrong 3\nend_header") + b"1 2 3\n" * 2, "line that means nothing: 'wrong 3'"),
    "length.ply": (LIST + b"x 1 2 3\n" * 2, "expected the length of the list weight in 'x 1 2 3'"),
    "row.ply": (LIST + b"1 7 1 2 3\n1 7 1 2 3 4\n", "expected 5 numbers in a row, got 6: '1 7 1 2 3 4'"),
    "packed.ply": (PACKED_LIST + (b"\1" + b"\1" * 16) * 3, "holds 17 bytes more than the 2 points"),
    "records.ply": (PACKED_LIST.replace(b"vertex 2", b"vertex 200") + b"\1" * 17, "200 records of vertex, 17 bytes are left"),
    "ragged.ply": (PLY + b"1 2 3\n1 2\n", "number of columns changed"),
    "word.ply": (PLY + b"1 2 3\n1 2 x\n", "could not convert string 'x'"),
    "short.pcd": (PCD.replace(b" 2\n", b" 3\n") + b"1 2 3\n", "truncated: its header promises 3 points, 1 are there"),
    "long.pcd": (PCD + b"1 2 3\n" * 3, "holds 3 points, more than the 2 of its header"),
    "grid.pcd": (PCD.replace(b"WIDTH 2", b"WIDTH 3"), "WIDTH x HEIGHT is not POINTS"),
    "bare.pcd": (PCD.replace(b"WIDTH 2", b"WIDTH"), "has a damaged PCD header"),  # once an IndexError
    "no_data.pcd": (PCD.replace(b"DATA", b"DUTY"), "its header has no DATA line"),
    "count.pcd": (PCD.replace(b"WIDTH", b"COUNT 1 1 -1\nWIDTH"), r"damaged PCD header \(ValueError: COUNT -1\)"),
    "counts.pcd": (PCD.replace(b"WIDTH", b"COUNT 1 1 4097\nWIDTH"), r"damaged PCD header \(ValueError: COUNT 4097\)"),
    "kind.pcd": (PCD.replace(b"TYPE F", b"TYPE Q"), "damaged PCD header"),
    "storage.pcd": (PCD.replace(b"ascii", b"zip"), "stores its data as 'zip'"),
    "lzf.pcd": (PCD.replace(b"ascii", b"binary_compressed") + b"\1\0\0\0\x18\0\0\0\x40", "breaks off"),
    "short_lzf.pcd": (PCD.replace(b"ascii", b"binary_compressed") + b"\x40\0\0\0\x18\0\0\0\x17" + b"\1" * 24,
                      "its header promises 64 compressed bytes, 25 are there"),
    "readme.txt": (b"This scan was made\nin 2024.\n", "is no point cloud: line 1 holds neither numbers nor column names"),
    "other.csv": (b"time,value\n1,2\n", "holds neither numbers nor column names"),
    "two_columns.xyz": (b"1 2\n3 4\n", "has 2 numbers a row, expected at least 3"),
    "ragged.csv": (b"x,y,z,name\n1,2,3,a\n4,5,-\n", "has rows of 3 to 4 cells, expected 4"),
    "word.csv": (b"x,y,z,name\n1,2,3,a\n4,5,word,b\n", "could not convert string 'word'"),
    "ragged.xyz": (b"1 2 3\n4 5\n", "number of columns changed"),
    "comments.xyz": (b"# nothing\n\n", "holds no point, only blank lines or comments"),
    "names.csv": (b"x,y,z\n", "holds no point"),
    "binary.xyz": (b"1 2 3\n\0\0 4", "holds binary data"),
    "nan.xyz": (b"nan nan nan\n" * 3, r"holds no valid point \(3 invalid returns\)"),
    "short.pts": (b"3\n1 2 3\n", "a block promises 3 points, 1 are there"),
    "long.pts": (b"1\n1 2 3\n4 5 6\n", "expected a number of points, got '4 5 6'"),
    "zero.pts": (b"0\n", "holds no point"),
    "short.ptx": (PTX_SCAN.encode() + b"1 2 3 0\n", "a scan promises 4 points, 1 are there"),
    "pose.ptx": (PTX_SCAN.replace("10 20 30 1\n", "10 20 30 2\n").encode() + PTX_ROWS.encode(), "whose last column is"),
    "header.ptx": (PTX_SCAN.replace("10 20 30 1\n", "").encode() + PTX_ROWS.encode(), "is damaged"),
    "nothing.ptx": ((PTX_SCAN + "0 0 0 0\n" * 4).encode(), r"holds no valid point \(4 invalid returns\)"),
    "faces.obj": (b"f 1 2 3\n", "there is no vertex line"),
    "two.obj": (b"v 1 2\n", "has 2 numbers a row"),
    "magic.las": (b"LASF" + b"\0" * 300, "is damaged or truncated"),
    "magic.e57": (b"ASTM-E57" + b"\0" * 2000, "is damaged or truncated"),
    "cut.xyz.gz": (gzip.compress(os.urandom(9000).hex().encode())[:5000], "gzip stream is broken"),
    "bent.xyz.gz": (gzip.compress(b"1 2 3\n" * 99)[:-6] + b"\0" * 6, "gzip stream is broken"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_broken_file(tmp_path, name):
    content, words = BROKEN[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(PointFileError, match=words) as caught:
        read_points(path, unit="m")
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_failed_write_of_laz_is_a_sentence(tmp_path):
    """lazrs makes a RuntimeError of its own of what the file says."""

    class Filling(io.BufferedRandom):
        """Room for the header alone."""

        def write(self, data):
            if self.tell() + len(data) > 1000:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)

    cloud = RawCloud(np.random.default_rng(0).normal(size=(60_000, 3)))
    with Filling(io.FileIO(tmp_path / "a.laz", "w+")) as file:
        sink = LasSink(file, cloud, compressed=True, step=1e-3)
        with pytest.raises(BadFile, match="cannot be written"):
            sink.append(cloud)


def test_things_that_are_no_files(tmp_path):
    with pytest.raises(PointFileError, match=r"absent\.ply: does not exist"):
        read_points(tmp_path / "absent.ply")
    with pytest.raises(PointFileError, match="is a folder"):
        read_points(tmp_path)
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(PointFileError, match="is a folder"):
        read_points(tmp_path / "folder.ply")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(PointFileError, match="is no regular file"):
        read_points(tmp_path / "pipe.ply")


def test_every_cut_of_a_counted_file_is_noticed(tmp_path):
    """A prefix of a file is never a smaller cloud, but for one that lacks its last record and no more: that is warned of."""
    for ending, record in (("ply", 31), ("pcd", 20)):
        path = tmp_path / f"a.{ending}"
        write_points(path, XYZ, color=COLOR, intensity=INTENSITY)
        whole = path.read_bytes()
        for cut in {*range(0, len(whole), 3)} - {len(whole) - record}:
            path.write_bytes(whole[:cut])
            with pytest.raises(PointFileError):
                read_points(path)
        path.write_bytes(whole[:-record])
        with pytest.warns(UserWarning, match="promises 3 points, 2 are there and were read"):
            assert len(read_points(path).xyz_mm) == 2


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_cut_las_files_are_noticed(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    write_points(path, np.random.default_rng(0).normal(size=(500, 3)))
    whole = path.read_bytes()
    for cut in (100, len(whole) // 2, len(whole) - 40):
        path.write_bytes(whole[:cut])
        with pytest.raises(PointFileError, match="truncated"):
            read_points(path)


def fake_child(tmp_path, monkeypatch, source):
    script = tmp_path / "fake.py"
    script.write_text(source)
    monkeypatch.setattr(isolated.child, "__file__", str(script))
    (tmp_path / "a.laz").write_bytes(b"LASF")
    return tmp_path / "a.laz"


def test_a_reader_that_hangs_is_stopped(tmp_path, monkeypatch):
    path = fake_child(tmp_path, monkeypatch, "import time\ntime.sleep(100)")
    with pytest.raises(PointFileError, match=r"could not be read within 0\.5 s"):
        read_points(path, time_limit_s=0.5)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_reader_that_aborts_is_reported(tmp_path, monkeypatch):
    path = fake_child(tmp_path, monkeypatch, "import os\nos.abort()")
    with pytest.raises(PointFileError, match=r"its reader crashed \(SIGABRT\)"):
        read_points(path)


def test_the_child_imports_neither_jax_nor_cablejax(tmp_path, monkeypatch):
    code = "import sys, runpy\nsys.modules['jax'] = sys.modules['cablejax'] = None\nrunpy.run_path({!r}, run_name='__main__')"
    real = isolated.child.__file__
    write_points(tmp_path / "b.laz", XYZ)
    fake_child(tmp_path, monkeypatch, code.format(real))
    assert len(read_points(tmp_path / "b.laz").xyz_mm) == 3


@pytest.mark.parametrize("data", [b"\x40\0", b"\x20\x05", b"\x1f", b"\x00A\xe0\xff\x00"])
def test_lzf_damage(data):
    with pytest.raises(BadFile):
        lzf_decompress(data, 3)


def test_lzf_overlapping_reference_repeats():
    assert lzf_decompress(b"\x01AB\xe0\x01\x01", 12) == b"AB" * 6


def test_broken_e57_files(data_dir):
    folder = data_dir / "parsers" / "e57" / "libE57Format-test-data" / "self"
    assert len(read_points(folder / "ColouredCubeFloat.e57", unit="m").xyz_mm) == 7680
    for name, words in [
        ("bad-crc.e57", "checksum"),
        ("ZeroPointsInvalid.e57", "no point"),
        ("测试点云.e57", "no point"),
    ]:
        with pytest.raises(PointFileError, match=words):
            read_points(folder / name, unit="m")
