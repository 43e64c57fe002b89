# ruff: noqa: T201 - a script that prints what it saw
"""A sweep of 100 jobs in one process: its memory must not grow with the jobs.

    .venv/bin/python -m tests.sweeps.hundred_jobs

Takes a minute or two, so it is a script and no test. It exits 1 where the process holds more than a twentieth more memory after
the last job than after the twentieth, when everything is compiled.
"""

import contextlib
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from experiments import table1_filtering
from experiments.harness import app
from experiments.harness.schema import Config

JOBS, WARM, EVERY = 100, 20, 10
MOST_GROWTH = 1.05


def resident_mb() -> float:
    """The process's resident memory (Linux)."""
    found = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def main() -> None:
    """Run the sweep and tell the memory after every tenth job."""
    held: list[float] = []

    def task(cfg: Config, folder: Path) -> dict[str, Any]:
        metrics = table1_filtering.run(cfg, folder)
        held.append(resident_mb())
        if len(held) % EVERY == 0:
            print(f"after {len(held)} jobs: {held[-1]:,.0f} MB", file=sys.stderr, flush=True)
        return metrics

    with tempfile.TemporaryDirectory() as out:
        sys.argv = ["table1_filtering", "-m", "size=smoke", "noise=none", "filter=statistical", f"seed=range({JOBS})",
                    f"out={out}"]  # fmt: skip
        with contextlib.redirect_stdout(None):
            app.main(task, experiment="table1_filtering", headline=table1_filtering.headline)
    growth = held[-1] / held[WARM - 1]
    print(f"{len(held)} jobs; memory after the last over that after job {WARM}: {growth:.3f}")
    sys.exit(len(held) != JOBS or growth > MOST_GROWTH)


if __name__ == "__main__":
    main()
