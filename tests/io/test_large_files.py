"""Clouds larger than memory: read and written piece by piece, and nothing left behind when something fails."""

import gc
import gzip
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from cablejax.io import PointFileError, PointWriter, iter_points, read_points, write_points

RNG = np.random.default_rng(3)
XYZ = RNG.normal(scale=50.0, size=(1000, 3))
COLOR = RNG.integers(0, 256, (1000, 3)).astype(np.uint8)
INTENSITY = RNG.integers(0, 65536, 1000).astype(np.float32)
ENDINGS = ["ply", "pcd", "xyz", "csv", "las", "laz"]


@pytest.mark.parametrize("ending", ENDINGS)
def test_pieces_make_the_whole(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    write_points(path, XYZ, color=COLOR, intensity=INTENSITY)
    whole, parts = read_points(path), list(iter_points(path, chunk=300))
    assert [len(part.xyz_mm) for part in parts] == [300, 300, 300, 100]
    for name in ("xyz_mm", "color", "intensity"):
        assert np.array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name))
    assert all(np.array_equal(part.shift_mm, parts[0].shift_mm) for part in parts)


@pytest.mark.parametrize("ending", ENDINGS)
def test_written_in_pieces_or_at_once(tmp_path, ending):
    """The same records either way; LAS takes its origin from the first piece, so its multiples may differ by one step."""
    with PointWriter(tmp_path / f"a.{ending}", step_mm=1e-6) as writer:
        for part in np.split(np.arange(1000), [1, 400, 401]):
            writer.write(XYZ[part], color=COLOR[part], intensity=INTENSITY[part])
    write_points(tmp_path / f"b.{ending}", XYZ, color=COLOR, intensity=INTENSITY)
    a, b = read_points(tmp_path / f"a.{ending}"), read_points(tmp_path / f"b.{ending}")
    assert np.abs(a.xyz_mm - b.xyz_mm).max() <= (1.001e-6 if ending in ("las", "laz") else 0)
    assert np.array_equal(a.color, b.color)
    assert np.array_equal(a.intensity, b.intensity)
    if ending not in ("las", "laz"):
        assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()


def test_gzipped_and_e57_files_in_pieces(tmp_path):
    import pye57

    write_points(tmp_path / "a.ply", XYZ)
    (tmp_path / "a.ply.gz").write_bytes(gzip.compress((tmp_path / "a.ply").read_bytes()))
    assert np.array_equal(np.concatenate([part.xyz_mm for part in iter_points(tmp_path / "a.ply.gz", chunk=7)]), XYZ)
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        file.write_scan_raw({f"cartesian{axis}": column for axis, column in zip("XYZ", XYZ.T, strict=True)})
    parts = list(iter_points(tmp_path / "a.e57", unit="m", chunk=400))
    assert [len(part.xyz_mm) for part in parts] == [400, 400, 200]
    # pye57 writes single precision: half a step below 256 is 7.6e-6.
    assert np.abs(np.concatenate([part.xyz_mm for part in parts]) / 1000 - XYZ).max() < 1e-5


def test_dropped_returns_are_counted_once(tmp_path):
    rows = ["nan 0 0"] * 3 + ["1 2 3"] + ["nan 0 0"] * 4 + ["4 5 6"] + ["nan 0 0"] * 2
    (tmp_path / "a.xyz").write_text("\n".join(rows))
    parts = list(iter_points(tmp_path / "a.xyz", chunk=2))
    assert np.concatenate([part.xyz_mm for part in parts]).tolist() == [[1, 2, 3], [4, 5, 6]]
    assert sum(part.dropped for part in parts) == 9
    (tmp_path / "b.xyz").write_text("nan 0 0\n" * 5)
    with pytest.raises(PointFileError, match=r"no valid point \(5 invalid returns\)"):
        list(iter_points(tmp_path / "b.xyz", chunk=2))


@pytest.mark.parametrize("ending", ["ply", "pcd", "las"])
def test_a_cut_file_fails_before_its_first_piece(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    write_points(path, XYZ)
    path.write_bytes(path.read_bytes()[:-31])
    with pytest.raises(PointFileError, match="promises 1,000 points"):
        next(iter_points(path, chunk=10))


def test_a_cut_gzipped_or_packed_file_fails_at_the_cut(tmp_path):
    write_points(tmp_path / "a.ply", XYZ)
    (tmp_path / "a.ply.gz").write_bytes(gzip.compress((tmp_path / "a.ply").read_bytes()[:-30]))
    write_points(tmp_path / "a.laz", XYZ)
    (tmp_path / "a.laz").write_bytes((tmp_path / "a.laz").read_bytes()[:-3000])
    for name in ("a.ply.gz", "a.laz"):
        with pytest.raises(PointFileError, match="truncated"):
            list(iter_points(tmp_path / name, chunk=100))


def test_an_iterator_that_is_dropped_ends_its_reader(tmp_path):
    write_points(tmp_path / "a.laz", np.zeros((300_000, 3)))
    children = f"/proc/self/task/{__import__('threading').get_native_id()}/children"
    parts = iter_points(tmp_path / "a.laz", chunk=1000)
    next(parts)
    with open(children) as file:
        running = file.read().split()
    parts.close()
    gc.collect()
    with open(children) as file:
        assert set(file.read().split()) < set(running)


def test_chunk_must_be_positive(tmp_path):
    with pytest.raises(ValueError, match="chunk: expected 1 or more, got 0"):
        next(iter_points(tmp_path / "a.ply", chunk=0))


def test_reading_in_pieces_takes_little_memory(tmp_path):
    """48 MB of points within 30 MB of memory beyond what the program itself takes; read whole they take 96 MB and more."""
    with PointWriter(tmp_path / "a.ply") as writer:
        for _ in range(20):
            writer.write(np.ones((100_000, 3)))
    code = """
import resource, sys
from cablejax.io import iter_points
next(iter_points(sys.argv[1], chunk=50_000))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(sum(len(part.xyz_mm) for part in iter_points(sys.argv[1], chunk=50_000)))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "a.ply")], capture_output=True, text=True, check=True
    )
    points, growth_kb = map(int, run.stdout.split())
    assert points == 2_000_000
    assert growth_kb < 30_000


def write_pieces(path, *pieces):
    with PointWriter(path) as writer:
        for piece in pieces:
            writer.write(**piece)


def test_pieces_must_be_alike(tmp_path):
    with pytest.raises(ValueError, match="expected uint8 color and no intensity as in the first piece, got no color"):
        write_pieces(tmp_path / "a.ply", {"xyz_mm": XYZ, "color": COLOR}, {"xyz_mm": XYZ})
    assert list(tmp_path.iterdir()) == []


def test_a_writer_without_points_or_after_its_block(tmp_path):
    with pytest.raises(ValueError, match="at least one piece"), PointWriter(tmp_path / "a.ply"):
        pass
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="expected an open one"):
        PointWriter(tmp_path / "a.ply").write(XYZ)


@pytest.mark.parametrize(
    ("second", "words"),
    [
        ({"xyz_mm": XYZ + 1e9, "intensity": INTENSITY}, "too far for a step"),
        ({"xyz_mm": XYZ, "intensity": XYZ[:, 0]}, "later ones are not"),
    ],
)
def test_las_pieces_that_do_not_fit_are_refused(tmp_path, second, words):
    with pytest.raises(PointFileError, match=words):
        write_pieces(tmp_path / "a.laz", {"xyz_mm": XYZ, "intensity": INTENSITY}, second)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_full_disk_leaves_the_old_file(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    write_points(path, XYZ[:10])
    old_bytes, limit = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, limit[1]))
    try:
        with pytest.raises(PointFileError, match=r"cannot be written"):
            write_points(path, XYZ)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == old_bytes


KILLED = """
import sys
import numpy as np
from cablejax.io import PointWriter
with PointWriter(sys.argv[1]) as writer:
    for _ in range(10**6):
        writer.write(np.ones((1000, 3)))
        print("piece", flush=True)
"""


@pytest.mark.parametrize("ending", ["ply", "laz"])
def test_a_write_killed_midway_leaves_the_old_file(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    write_points(path, XYZ[:10])
    old = path.read_bytes()
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    for _ in range(5):
        process.stdout.readline()
    time.sleep(0.02)
    process.kill()
    process.communicate()
    assert path.read_bytes() == old


@pytest.mark.parametrize("seed", range(6))
def test_round_trips_of_random_clouds(tmp_path, seed):
    """Every format, any size, scale, offset and unit; errors within what each format's step allows."""
    rng = np.random.default_rng(seed)
    n, unit = int(rng.integers(1, 200)), ["mm", "m", "cm", "in", "ft", "km"][seed]
    scale = {"mm": 1, "m": 1000, "cm": 10, "in": 25.4, "ft": 304.8, "km": 1e6}[unit]
    width, offset = 10.0 ** rng.uniform(0, 4), 10.0 ** rng.uniform(0, 9)
    xyz = rng.normal(scale=width, size=(n, 3)) + offset * rng.normal(size=3)
    color = rng.integers(0, 256, (n, 3)).astype(np.uint8) if rng.random() < 0.7 else None
    intensity = rng.normal(size=n).astype(np.float32) if rng.random() < 0.7 else None
    for ending in ("ply", "csv", "laz"):
        path = tmp_path / f"a.{ending}"
        write_points(path, xyz, unit=unit, color=color, intensity=intensity)
        scan = read_points(path, unit=unit)
        rounding = 4 * np.spacing(np.abs(xyz).max())  # two changes of unit
        reach = np.ptp(xyz, axis=0).max() / 2 + scale  # the origin is rounded to whole units
        step = max(1e-6 * scale, 10 * reach / 2**31) if ending == "laz" else 0.0
        assert np.abs(scan.xyz_mm - xyz).max() <= step / 2 + rounding * (4 if step else 1)
        if color is None:
            assert scan.color is None
        else:
            assert np.array_equal(scan.color if scan.color.dtype == np.uint8 else scan.color // 257, color)
        if intensity is not None:
            assert np.array_equal(scan.intensity, intensity)
