"""A Dask cluster on this machine: a scheduler and workers, each a process of its own."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.batch.folders import ROOT


class Cluster(NamedTuple):
    """Where the scheduler is, its process, and the workers'."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def cluster(folder: Path, *, workers: int) -> Iterator[Cluster]:
    """Start a cluster, and end it."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    start = [sys.executable, "-m"]
    which = ["--scheduler-file", str(file), "--no-dashboard"]
    own = ["--host", "127.0.0.1", "--port", "0"]
    scheduler = subprocess.Popen([*start, "distributed.cli.dask_scheduler", *which, *own], env=env, **quiet)
    worker = [
        *start,
        "distributed.cli.dask_worker",
        *which,
        "--nthreads",
        "1",
        "--no-nanny",
        "--local-directory",
        str(folder),
    ]
    started = [subprocess.Popen(worker, env=env, **quiet) for _ in range(workers)]
    try:
        while (address := _address(file)) is None:
            assert scheduler.poll() is None, "the scheduler did not start"
            time.sleep(0.05)
        yield Cluster(address, scheduler, started)
    finally:
        for process in [*started, scheduler]:
            process.kill()
            process.wait()


def _address(file: Path) -> str | None:
    """What the scheduler tells, once its file is whole: it writes the file in place."""
    try:
        return json.loads(file.read_text())["address"]
    except (FileNotFoundError, json.JSONDecodeError):
        return None
