# ruff: noqa: T201 - a script that prints what it saw
"""200 simulated scans and 10 broken ones: measured, killed twice and finished.

    .venv/bin/python -m tests.batch.two_hundred

Takes ten minutes or more, so it is a script and no test. It exits 1 unless all tables are the same byte for byte.
"""

import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

from cablejax.io import write_points
from cablejax.simulate import catalogue, simulate_scan
from tests.batch import folders

SCANS, BROKEN = 200, 10


def simulate(folder: Path) -> None:
    """Scans of all sizes, arcs from 120 to 360 degrees, 2,000 points each."""
    folder.mkdir()
    cables = catalogue("8.7/15")
    for i in range(SCANS):
        arc = 120.0 + 240.0 * i / (SCANS - 1)
        scan = simulate_scan(cables[i % len(cables)], n_points=2000, arc_deg=arc, key=jax.random.key(i))
        write_points(folder / f"scan{i:03}.ply", np.asarray(scan.xyz_mm, dtype=np.float64))
    folders.break_some(folder, BROKEN)


def main() -> int:
    work = Path(tempfile.mkdtemp())
    simulate(work / "scans")
    measure = ["measure", str(work / "scans"), "--unit", "mm", "--catalogue", "8.7/15"]
    for jobs in (1, 2):
        start = time.monotonic()
        done = folders.run(*measure, "--csv", str(work / f"jobs{jobs}.csv"), "--jobs", str(jobs))
        print(f"{jobs} job(s): {time.monotonic() - start:.0f} s, exit code {done.returncode}", flush=True)
    print(done.stdout)
    killed = work / "killed.csv"
    for after in (60, 140):
        code = folders.run_killed(killed, *measure, "--csv", str(killed), "--jobs", "2", after=after)
        print(f"killed ({code}) with {folders.lines_of(killed) - 1} of {SCANS + BROKEN} rows", flush=True)
    done = folders.run(*measure, "--csv", str(killed), "--jobs", "2")
    print(done.stderr.splitlines()[0])
    tables = {path.name: path.read_bytes() for path in sorted(work.glob("*.csv"))}
    same = {name: content == tables["jobs1.csv"] for name, content in tables.items()}
    print("the same as with one job:", same)
    return 0 if all(same.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
