"""Folders of scans: killed and finished as if nothing had been, done again where something has changed."""

import csv
import importlib
import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from cablejax.batch import columns_of
from cablejax.cli import main
from tests.batch import folders

POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and /proc")
SCANS, BROKEN = 8, 5


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch") / "scans"
    folders.fill(folder, scans=SCANS, broken=BROKEN, slow=2)
    return folder


@pytest.fixture(scope="module")
def whole(scans):
    """The tables of a run that nothing interrupted, with one process."""
    path = scans.parent / "whole.csv"
    done = folders.run(*arguments(scans, path, jobs=1))
    assert done.returncode == 0, done.stderr
    return path


def arguments(scans: Path, table: Path, *, jobs: int) -> list[str]:
    lines = str(table.with_suffix(".jsonl"))
    return ["measure", str(scans), "--unit", "mm", "--csv", str(table), "--jsonl", lines, "--jobs", str(jobs)]


def rows_of(table: Path) -> list[dict[str, str]]:
    with table.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_scan_has_its_row_in_order_and_both_tables_say_the_same(whole):
    rows = rows_of(whole)
    assert [row["file"] for row in rows] == sorted(row["file"] for row in rows)
    assert [row["outcome"] for row in rows] == ["no result"] * BROKEN + ["result"] * SCANS
    assert all(row["error"] for row in rows[:BROKEN])
    for row in rows[BROKEN:]:
        assert float(row["low_mm"]) < 30.1
        assert float(row["high_mm"]) > 29.9
    lines = [json.loads(line) for line in whole.with_suffix(".jsonl").read_text().splitlines()]
    same = [{name: "" if cell is None else str(cell) for name, cell in line.items()} for line in lines]
    assert same == rows


@POSIX
def test_killed_twice_and_finished_it_is_the_table_of_an_uninterrupted_run(scans, whole, tmp_path):
    table = tmp_path / "t.csv"
    command = arguments(scans, table, jobs=2)
    for after in (3, 7):
        assert folders.run_killed(table, *command, after=after) == -signal.SIGKILL
        assert after <= folders.lines_of(table) - 1 < SCANS + BROKEN
    kept = table.read_bytes().splitlines()
    done = folders.run(*command)
    assert (done.returncode, "scans are done already" in done.stderr) == (0, True)
    assert table.read_bytes() == whole.read_bytes()
    assert table.with_suffix(".jsonl").read_bytes() == whole.with_suffix(".jsonl").read_bytes()
    assert set(kept) <= set(table.read_bytes().splitlines())


@POSIX
def test_ctrl_c_keeps_the_rows_and_ends_the_processes(scans, tmp_path):
    table = tmp_path / "t.csv"
    assert folders.run_killed(table, *arguments(scans, table, jobs=2), after=2, with_signal=signal.SIGINT) == 130
    assert 2 <= len(rows_of(table)) < SCANS + BROKEN


@POSIX
def test_a_worker_killed_in_the_middle_costs_a_retry_and_nothing_else(scans, whole, tmp_path):
    table = tmp_path / "t.csv"
    process = subprocess.Popen(
        folders.command(*arguments(scans, table, jobs=2)),
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        cwd=folders.ROOT,
    )
    while folders.lines_of(table) < 3:
        time.sleep(0.01)
    folders.kill(folders.children_of(process.pid)[0])
    assert process.wait() == 0
    assert table.read_bytes() == whole.read_bytes()


def info(folder: Path, table: Path, *more: str) -> int:
    return main(["info", str(folder), "--unit", "mm", "--csv", str(table), "--jobs", "0", *more])


@pytest.fixture
def few(tmp_path):
    folders.fill(tmp_path / "few", scans=3, broken=0)
    return tmp_path / "few"


def done_now(capsys) -> int:
    """How many scans the last command did, rather than found done."""
    return sum(" left: " in line for line in capsys.readouterr().err.splitlines())


def test_what_is_unchanged_is_not_done_again(few, tmp_path, capsys):
    table = tmp_path / "t.csv"
    assert info(few, table) == 0
    before = table.read_bytes()
    assert done_now(capsys) == 3
    assert info(few, table) == 0
    assert (done_now(capsys), table.read_bytes()) == (0, before)
    assert info(few, table, "--no-resume") == 0
    assert (done_now(capsys), table.read_bytes()) == (3, before)


CHANGES = {
    "another time": lambda few, monkeypatch: os.utime(few / "scan001.ply", ns=(1, 1)),
    "another size": lambda few, monkeypatch: (few / "scan001.ply").write_bytes((few / "scan002.ply").read_bytes() + b"\n"),
    "a new file": lambda few, monkeypatch: (few / "scan9.ply").write_bytes((few / "scan002.ply").read_bytes()),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_a_scan_that_changed_is_done_again_alone(few, tmp_path, capsys, monkeypatch, change):
    table = tmp_path / "t.csv"
    info(few, table)
    done_now(capsys)
    CHANGES[change](few, monkeypatch)
    info(few, table)
    assert done_now(capsys) == 1
    assert [row["file"] for row in rows_of(table)] == sorted(path.name for path in few.iterdir())


def test_another_option_or_version_does_all_again(few, tmp_path, capsys, monkeypatch):
    table = tmp_path / "t.csv"
    info(few, table)
    done_now(capsys)
    info(few, table, "--columns", "x,y,z")
    assert done_now(capsys) == 3
    monkeypatch.setattr("cablejax.cli.folder.__version__", "9.9")
    info(few, table, "--columns", "x,y,z")
    assert done_now(capsys) == 3
    assert {row["version"] for row in rows_of(table)} == {"9.9"}


def test_a_folder_is_cleaned_into_another(few, tmp_path, capsys):
    arguments = [
        "denoise",
        str(few),
        str(tmp_path / "clean"),
        "--unit",
        "mm",
        "--no-filter",
        "--csv",
        str(tmp_path / "t.csv"),
        "--jobs",
        "0",
    ]
    assert main(arguments) == 0
    assert sorted(path.name for path in (tmp_path / "clean").iterdir()) == sorted(path.name for path in few.iterdir())
    assert done_now(capsys) == 3
    (tmp_path / "clean" / "scan001.ply").unlink()
    assert main(arguments) == 0
    assert done_now(capsys) == 1
    assert (tmp_path / "clean" / "scan001.ply").exists()
    assert main(["denoise", str(few), str(few), "--unit", "mm"]) == 1
    assert "expected another folder" in capsys.readouterr().err


def test_reasons_that_differ_in_numbers_alone_are_counted_together(few, capsys):
    for i in range(60):
        (few / f"few{i}.xyz").write_text("1 2 3\n" * (i + 1))
    assert (
        main(["denoise", str(few), str(few.parent / "clean"), "--unit", "mm", "--no-filter", "--jobs", "0", "--quiet"])
        == 0
    )
    out = capsys.readouterr().out
    assert "no result  60" in out
    assert "60 x  too few points: 1 where more than --neighbors 100 are needed (few0.xyz)" in out


def test_warnings_of_a_scan_stand_in_its_row(few, tmp_path):
    main(["info", str(few), "--csv", str(tmp_path / "t.csv"), "--jobs", "0", "--quiet"])
    assert all("no --unit given" in row["warnings"] for row in rows_of(tmp_path / "t.csv"))


@pytest.mark.parametrize("jobs", ["0", "1"])
def test_what_was_odd_about_a_file_stands_in_its_row_from_any_process(few, tmp_path, jobs):
    odd = few / "scan001.ply"
    odd.write_bytes(odd.read_bytes()[:-24])  # the last point: three coordinates of 8 bytes
    main(["info", str(few), "--unit", "mm", "--csv", str(tmp_path / "t.csv"), "--jobs", jobs, "--quiet"])
    said = {row["file"]: row["warnings"] for row in rows_of(tmp_path / "t.csv")}
    assert "scan001.ply: its header promises" in said.pop("scan001.ply")
    assert set(said.values()) == {""}


def test_the_options_of_folders_are_refused_for_a_file(few, capsys):
    for option, value in (("--csv", "t.csv"), ("--jsonl", "t.jsonl"), ("--scheduler", "tcp://127.0.0.1:1")):
        assert main(["info", str(few / "scan000.ply"), "--unit", "mm", option, value]) == 1
        assert f"{option}: is for a folder of scans" in capsys.readouterr().err
    assert main(["info", str(few), "--unit", "mm", "--jobs", "-1"]) == 1
    assert "--jobs: expected at least 1, got -1" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["measure", "info", "denoise"])
def test_every_column_is_documented(command):
    module = importlib.import_module(f"cablejax.cli.{command}")
    page = (folders.ROOT / "docs" / "batches.md").read_text(encoding="utf-8")
    assert f"`cablejax {command}`, `{module.SCHEMA}`:" in page
    for column in columns_of(module.COLUMNS):
        assert f"| `{column.name}` | {column.kind} | {column.meaning} |" in page
