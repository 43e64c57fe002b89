"""Folders of small simulated scans with broken ones among them, and a batch over them that is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from cablejax.io import write_points
from tests.reference.circles import bent_cable

ROOT = Path(__file__).resolve().parents[2]


def fill(folder: Path, *, scans: int, broken: int, slow: int = 0) -> None:
    """Write scans of a cable, each with noise of its own, and files that hold none.

    The last `slow` scans take seconds each, so that a batch is killed in its middle and not after its end.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(scans):
        write_points(folder / f"scan{i:03}.ply", bent_cable(n=1500 if i < scans - slow else 30_000, seed=i))
    break_some(folder, broken)


def break_some(folder: Path, broken: int) -> None:
    """Write files that give no result: half a scan, nothing, too few points, noise, text. None is twice the same."""
    whole = (folder / "scan000.ply").read_bytes()
    kinds = (
        (".ply", lambda i: whole[: len(whole) // 2 - i]),
        (".ply", lambda i: b""),
        (".xyz", lambda i: b"1 2 3\n" * (i + 1)),
        (".laz", lambda i: bytes(np.random.default_rng(i).integers(0, 256, 500, dtype=np.uint8))),
        (".txt", lambda i: b"no numbers\n"),
    )
    for i in range(broken):
        ending, content = kinds[i % len(kinds)]
        (folder / f"broken{i:02}{ending}").write_bytes(content(i))


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "cablejax.cli", *arguments]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own."""
    return subprocess.run(command(*arguments), capture_output=True, text=True, cwd=ROOT)


def run_killed(table: Path, *arguments: str, after: int, with_signal: int = signal.SIGKILL) -> int:
    """Start a command and kill it once its table holds so many rows; its exit status."""
    # A shell has what it starts in its background ignore Ctrl-C, which is inherited; a handler is not, so the command
    # begins with the default.
    ours = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(command(*arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT)
    finally:
        signal.signal(signal.SIGINT, ours)
    while process.poll() is None and lines_of(table) <= after:
        time.sleep(0.01)
    process.send_signal(with_signal)
    return process.wait()


def lines_of(table: Path) -> int:
    return len(table.read_bytes().splitlines()) if table.exists() else 0


def children_of(pid: int) -> list[int]:
    """Processes that a process has started and that still run."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == pid and fields[0] != "Z":
                found.append(int(entry.name))
    return found


def alive(pid: int) -> bool:
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
