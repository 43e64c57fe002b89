"""What a shell brings: locales, closed and full streams, odd names, paths that are none, folders with other files."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cablejax.batch import columns_of
from cablejax.cli import main, measure
from cablejax.io import atomic_write, read_points, write_points
from tests.kinds.test_wrong_data import write_e57
from tests.reference.circles import bent_cable

POSIX = pytest.mark.skipif(os.name != "posix", reason="shells and devices of POSIX")
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
C_LOCALE = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
LATIN = {"PYTHONIOENCODING": "latin-1"}
ASCII = {"PYTHONIOENCODING": "ascii"}
NAMES = [
    "größe.csv",
    "测试.csv",
    "a b.csv",
    "-a.csv",
    "new\nline.csv",
    b"\xff\xfe.csv".decode(errors="surrogateescape"),
]


def shell(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run a command line of sh in a folder; `cablejax` stands for the program."""
    program = f"cablejax() {{ '{sys.executable}' -m cablejax \"$@\"; }}\n"
    root = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(
        ["sh", "-c", program + command],
        cwd=folder,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": root, **environment},
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    assert b"Exception ignored" not in done.stderr, done.stderr.decode()
    return done


@pytest.fixture
def three(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z\n0,0,0\n100,2,3\n4,50,6\n")
    return tmp_path


# --- what the program says, where it cannot be said ---


SEVERAL = """
import glob, os, sys
from cablejax.cli import main
for name in sorted(glob.glob(os.path.join(sys.argv[1], "*"))):
    print("code", main(["info", "--unit", sys.argv[2], "--", name]))
"""


def info_of_all(folder: Path, unit: str, environment: dict[str, str]) -> bytes:
    """What `cablejax info` says of every file of a folder, in one process."""
    root = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(
        [sys.executable, "-c", SEVERAL, str(folder), unit],
        capture_output=True,
        env={**os.environ, "PYTHONPATH": root, **environment},
    )
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False), done.stderr
    return done.stdout


@POSIX
@pytest.mark.parametrize("environment", [C_LOCALE, LATIN, ASCII, {}], ids=["C", "latin-1", "ascii", "own"])
def test_names_that_the_stream_cannot_say(three, environment):
    for name in NAMES:
        (three / name).write_bytes((three / "a.csv").read_bytes())
    said = info_of_all(three, "mm", environment)
    assert said.count(b"code 0") == said.count(b"points      3") == len(NAMES) + 1


STREAMS = {
    "stdout closed": ("cablejax info a.csv --unit mm >&-", 1, b"standard output is closed"),
    "stdout and stdin closed": ("cablejax info a.csv --unit mm >&- <&-", 1, b"standard output is closed"),
    "all closed": ("cablejax info a.csv --unit mm >&- 2>&- <&-", 1, b""),
    "stderr closed": ("cablejax info a.csv --unit mm 2>&-", 0, b""),
    "stdout full": ("cablejax info a.csv --unit mm >/dev/full", 1, b"No space left"),
    "stdout full, JSON": ("cablejax info a.csv --unit mm --json >/dev/full", 1, b"No space left"),
    "stderr full": ("cablejax info a.csv 2>/dev/full", 0, b""),
    "help, full": ("cablejax measure --help >/dev/full", 1, b"No space left"),
    "nobody reads": ("cablejax info a.csv --unit mm --quiet | true", 0, b""),
    "a refusal, stderr closed": ("cablejax info b.csv 2>&-", 1, b""),
    "a refusal, stderr full": ("cablejax info b.csv 2>/dev/full", 1, b""),
}


@POSIX
@FULL
@pytest.mark.parametrize("kind", STREAMS)
def test_streams_that_are_closed_or_full(three, kind):
    command, code, words = STREAMS[kind]
    done = shell(command, three)
    assert done.returncode == code
    assert words in done.stderr


@POSIX
@pytest.mark.parametrize("program", ["cablejax", "cablejax.cli"])
def test_python_m(three, program):
    done = shell(f"'{sys.executable}' -m {program} info a.csv --unit mm", three)
    assert (done.returncode, b"points      3" in done.stdout) == (0, True)


@POSIX
def test_native_readers_take_any_name(tmp_path):
    write_e57(tmp_path / "a.e57", bent_cable(n=50))
    write_points(tmp_path / "a.laz", bent_cable(n=50), unit="m")
    for name in (b"\xff\xfe", "größe".encode(), b"-x"):
        for ending in (".e57", ".laz"):
            path = tmp_path / os.fsdecode(name + ending.encode())
            path.write_bytes((tmp_path / f"a{ending}").read_bytes())
    assert info_of_all(tmp_path, "m", C_LOCALE).count(b"points      50") == 8


# --- results that cannot be written ---


def refused(capsys, *arguments: str) -> str:
    """Run a command that must have no result; the line that it says."""
    assert main([*arguments, "--quiet"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("cablejax: ")
    assert err.count("\n") == 1
    return err


@pytest.fixture(scope="module")
def cable(tmp_path_factory):
    path = tmp_path_factory.mktemp("scans") / "cable.ply"
    write_points(path, bent_cable(n=4000))
    return str(path)


def outputs(command: str, scan: str, path: str) -> list[str]:
    """A command that writes `path`, with the ending that it writes."""
    return {
        "report": ["report", scan, f"{path}.html", "--unit", "mm"],
        "measure": ["measure", scan, "--report", f"{path}.html", "--unit", "mm"],
        "folder": ["measure", str(Path(scan).parent), "--csv", f"{path}.csv", "--unit", "mm"],
        "denoise": ["denoise", scan, f"{path}.ply", "--unit", "mm"],
        "simulate": ["simulate", f"{path}.ply", "--points", "2000"],
        "register": ["register", scan, scan, "--output", f"{path}.ply", "--unit", "mm"],
    }[command]


WRITERS = ["report", "measure", "folder", "denoise", "simulate", "register"]


@pytest.mark.parametrize("command", WRITERS)
def test_a_folder_that_is_a_file(tmp_path, capsys, cable, command):
    (tmp_path / "file").write_text("no folder")
    assert "file" in refused(capsys, *outputs(command, cable, str(tmp_path / "file" / "out")))
    assert "file" in refused(capsys, *outputs(command, cable, str(tmp_path / "file" / "deep" / "out")))
    assert (tmp_path / "file").read_text() == "no folder"


@pytest.mark.parametrize("command", WRITERS)
def test_a_file_that_is_a_folder(tmp_path, capsys, cable, command):
    for ending in ("html", "csv", "ply"):
        (tmp_path / f"out.{ending}").mkdir()
    assert "is a folder" in refused(capsys, *outputs(command, cable, str(tmp_path / "out")))


@POSIX
@FULL
@pytest.mark.parametrize("command", WRITERS)
def test_a_link_to_a_device_is_left_alone(tmp_path, capsys, cable, command):
    for ending in ("html", "csv", "ply"):
        (tmp_path / f"out.{ending}").symlink_to("/dev/full")
    assert "is no regular file" in refused(capsys, *outputs(command, cable, str(tmp_path / "out")))
    assert Path("/dev/full").is_char_device()


@POSIX
@FULL
def test_an_atomic_write_never_takes_a_devices_place(tmp_path):
    (tmp_path / "link").symlink_to("/dev/full")
    with pytest.raises(OSError, match="is no regular file"), atomic_write(tmp_path / "link"):
        pass
    assert Path("/dev/full").is_char_device()


@pytest.mark.parametrize("command", WRITERS)
def test_a_name_that_is_too_long(tmp_path, capsys, cable, command):
    assert "ame too long" in refused(capsys, *outputs(command, cable, str(tmp_path / ("n" * 300))))


LIMITED = """
import resource, signal, sys
from cablejax.cli import {module}, main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
{patch}
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
sys.exit(main(sys.argv[1:]))
"""
# A page without a measurement: what is tried is the disk.
PAGE = (
    "import cablejax.report, cablejax.measure\n"
    "measure.one = lambda options: measure.measure_input.save_report(options, '<html>' * 100)"
)
ROW = "measure.one = lambda options: {'file': 'a' * 200, 'error': 'e'}"


@POSIX
@pytest.mark.parametrize(
    ("arguments", "patch"),
    [
        (["report", "a.ply", "old.html", "--unit", "mm"], PAGE),
        (["measure", "a.ply", "--report", "old.html", "--unit", "mm"], PAGE),
        (["measure", ".", "--csv", "old.csv", "--unit", "mm", "--jobs", "0"], ROW),
    ],
)
def test_a_full_disk_under_a_report_or_a_table(tmp_path, arguments, patch):
    write_points(tmp_path / "a.ply", np.eye(3))
    (tmp_path / "old.html").write_text("old")
    code = LIMITED.format(module="measure", patch=patch)
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=tmp_path, capture_output=True)
    assert (done.returncode, b"Traceback" in done.stderr) == (1, False), done.stderr
    assert b"cannot be written" in done.stderr
    assert (tmp_path / "old.html").read_text() == "old"


# --- a folder of scans ---


def fake(monkeypatch, **of_name):
    """Let measuring a scan give what stands for its name, an exception too."""

    def one(options):
        result = of_name.get(Path(options.scan).stem.split(".")[0], 30.0)
        if isinstance(result, BaseException):
            raise result
        interval, read = (result - 1, result + 1), {"mean_mm": result}
        return {"file": options.scan, "diameter_mm": result, "interval_mm": interval, "readings": read, "verdict": None}

    monkeypatch.setattr(measure, "one", one)


def table_of(path: Path) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return {Path(row["file"]).name: row for row in csv.DictReader(stream)}


OTHERS = [".hidden.ply", "._mac.ply", ".a.ply.0badcafe.part", "scans.tar.gz", "old.tgz", "notes.json.gz", "report.html",
          "a.ply.html", "picture.png", "last.csv", "Thumbs.db", "clean.ply.tiles"]  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_no_scan_is_left_alone(tmp_path, capsys, monkeypatch, name):
    fake(monkeypatch)
    (tmp_path / "a.ply").write_text("a scan")
    (tmp_path / name).write_text(
        ",".join([column.name for column in columns_of(measure.COLUMNS)]) + "\n"
        if name == "last.csv"
        else "something else"
    )
    assert main(["measure", str(tmp_path), "--csv", str(tmp_path / "now.csv"), "--jobs", "0", "--quiet"]) == 0
    assert list(table_of(tmp_path / "now.csv")) == ["a.ply"]


@pytest.mark.parametrize("name", ["b.PLY", "b.asc", "b.dat", "b.copc.laz", "b.ply.gz", "b.gz", "b c.xyz", "b.csv"])
def test_what_is_a_scan_is_measured(tmp_path, capsys, monkeypatch, name):
    fake(monkeypatch)
    for scan in ("a.ply", name):
        (tmp_path / scan).write_text("a scan")
    assert main(["measure", str(tmp_path), "--csv", str(tmp_path / "now.csv"), "--jobs", "0", "--quiet"]) == 0
    assert list(table_of(tmp_path / "now.csv")) == ["a.ply", name]


CRASHES = [
    ValueError("odd"),
    ZeroDivisionError(),
    MemoryError(),
    RuntimeError("odd"),
    OSError(5, "disk"),
    RecursionError(),
]


@pytest.mark.parametrize("crash", CRASHES, ids=lambda crash: type(crash).__name__)
def test_one_scan_that_crashes_costs_no_other(tmp_path, capsys, monkeypatch, crash):
    fake(monkeypatch, b=crash)
    for name in ("a.ply", "b.ply", "c.ply"):
        (tmp_path / name).write_text("a scan")
    assert main(["measure", str(tmp_path), "--csv", str(tmp_path / "now.csv"), "--jobs", "0", "--quiet"]) == 0
    rows = table_of(tmp_path / "now.csv")
    assert [row["diameter_mm"] for row in rows.values()] == ["30.0", "", "30.0"]
    assert type(crash).__name__ in rows["b.ply"]["error"]


def test_rows_are_there_as_soon_as_they_are_known(tmp_path, capsys, monkeypatch):
    fake(monkeypatch, c=KeyboardInterrupt())
    for name in ("a.ply", "b.ply", "c.ply"):
        (tmp_path / name).write_text("a scan")
    assert main(["measure", str(tmp_path), "--csv", str(tmp_path / "now.csv"), "--jobs", "0", "--quiet"]) == 130
    assert list(table_of(tmp_path / "now.csv")) == ["a.ply", "b.ply"]


@POSIX
def test_names_that_are_no_text_in_tables_and_reports(tmp_path, capsys, cable):
    name = b"\xff.ply".decode(errors="surrogateescape")
    (tmp_path / name).write_bytes(Path(cable).read_bytes())
    arguments = ["measure", str(tmp_path), "--unit", "mm", "--csv", str(tmp_path / "t.csv")]
    assert main([*arguments, "--report", str(tmp_path / "r"), "--quiet"]) == 0
    assert "udcff.ply" in (tmp_path / "t.csv").read_text(encoding="utf-8")
    (page,) = (tmp_path / "r").iterdir()
    assert "udcff.ply" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("content", ["", "{", "null"])
def test_a_damaged_run_is_one_line(tmp_path, capsys, cable, content):
    (tmp_path / "run.json").write_text(content)
    for command in ("classify", "measure"):
        arguments = [command, cable, "--unit", "mm", "--checkpoint", str(tmp_path)]
        assert "--checkpoint" in refused(capsys, *arguments)


def test_the_files_own_unit_is_taken(tmp_path, capsys):
    write_e57(tmp_path / "a.e57", bent_cable(n=200))
    assert main(["info", str(tmp_path / "a.e57")]) == 0
    captured = capsys.readouterr()
    assert "read as m" in captured.out
    assert "warning" not in captured.err
    assert np.ptp(read_points(tmp_path / "a.e57", unit=None).xyz_mm[:, 0]) > 100_000
