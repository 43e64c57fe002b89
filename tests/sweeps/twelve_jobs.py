# ruff: noqa: T201 - a script that prints what it saw
"""A sweep of 12 jobs killed twice and finished, then the same sweep under joblib and submitit's local executor.

    .venv/bin/python -m tests.sweeps.twelve_jobs

Takes a few minutes, so it is a script and no test. The process group dies by SIGKILL as soon as 3, and then 7, jobs are done.
It exits 1 unless finished jobs were left alone and all launchers gave the same numbers, bit by bit (timings apart).
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from cablejax.io import read_json
from experiments import ROOT
from experiments.collect import flatten

JOBS = 12
SWEEP = [
    sys.executable,
    "-m",
    "experiments.table1_filtering",
    "-m",
    "experiment=table1_filtering",
    "size=smoke",
    "seed=0",
]
# One thread each, whatever the launcher: another number of threads changes the last bits.
ENVIRONMENT = {**os.environ, "NPROC": "1", "OMP_NUM_THREADS": "1"}
LAUNCHERS = ("joblib", "submitit_local")
WAIT_S = 0.05


def finished(out: Path) -> dict[Path, int]:
    """The records of finished jobs, and when each was written."""
    return {path: path.stat().st_mtime_ns for path in out.rglob("run.json")}


def killed_after(jobs: int, out: Path) -> dict[Path, int]:
    """Start the sweep, kill its whole process group when so many jobs are done, and say which those are."""
    with subprocess.Popen([*SWEEP, f"out={out}"], cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.DEVNULL,
                          start_new_session=True) as process:  # fmt: skip
        while len(finished(out)) < jobs:
            if process.poll() is not None:
                raise SystemExit(f"the sweep ended by itself ({process.returncode}) before {jobs} jobs were done")
            time.sleep(WAIT_S)
        os.killpg(process.pid, signal.SIGKILL)
    return finished(out)


def whole(out: Path, *overrides: str) -> str:
    """Run the sweep to its end and return the first line of its summary."""
    done = subprocess.run([*SWEEP, *overrides, f"out={out}"], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True,
                          check=True)  # fmt: skip
    return next(line for line in done.stdout.splitlines() if f"{JOBS} jobs:" in line)


def numbers(out: Path) -> dict[str, dict[str, Any]]:
    """Every job's metrics by its configuration's digest, seconds apart."""
    records = {path.parent.name: read_json(path)["metrics"] for path in finished(out)}
    return {
        name: {key: value for key, value in flatten(metrics).items() if "seconds" not in key}
        for name, metrics in records.items()
    }


def main() -> None:
    """Kill, finish, compare."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder) / "basic"
        first = killed_after(3, here)
        print(f"killed with {len(first)} jobs done", flush=True)
        second = killed_after(7, here)
        print(f"killed again with {len(second)} jobs done", flush=True)
        print(f"finished: {whole(here)}", flush=True)
        last = finished(here)
        again = [path.parent.name for path, stamp in {**second, **first}.items() if last[path] != stamp]
        expected = numbers(here)
        bad = bool(again) or len(expected) != JOBS
        print(f"jobs that were done twice: {', '.join(again) or 'none'}", flush=True)
        for launcher in LAUNCHERS:
            there = Path(folder) / launcher
            told = whole(there, f"launcher={launcher}")
            # The digest leaves out the place of the runs, so that the same job has the same name.
            same = {k.rsplit("-", 1)[1]: v for k, v in numbers(there).items()} == {
                k.rsplit("-", 1)[1]: v for k, v in expected.items()
            }
            bad |= not same
            print(f"{launcher}: {told}; {'identical numbers' if same else 'OTHER NUMBERS'}", flush=True)
    sys.exit(bad)


if __name__ == "__main__":
    main()
