"""`cablejax denoise` in tiles from 1e5 points upwards, LAZ to LAZ: time and peak memory: `python -m benchmarks.tiles`.

Each size runs in a process of its own, so that the peak is its own; compiling is part of the seconds, where nothing was kept.
`--jobs 1 2` works in processes instead, which is what the command does, and says how much quicker two are than one.
"""

import argparse
import contextlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import record
from benchmarks.timing import half_cylinder

RESULT = Path("results/benchmarks/tiles.json")
JOBS_RESULT = RESULT.with_name("tiles_jobs.json")


def write_scan(path: Path, n: int) -> None:
    """A cable of n points with strays, a million at a time."""
    from cablejax.io import PointWriter

    with PointWriter(path) as writer:
        for start in range(0, n, 1_000_000):
            piece = half_cylinder(min(1_000_000, n - start), stray_share=0.02, seed=start)
            writer.write(piece.astype(np.float64) + np.array([0.0, 0.0, 300.0 * start / 53_135]))


def measure(source: str, target: str, tile: int, k: int, jobs: int) -> dict[str, Any]:
    """Seconds and peak memory of one run, and when each stage began."""
    from cablejax.batch import engine_for
    from cablejax.runtime import set_up_jax
    from cablejax.tiles import Settings, denoise_file

    if jobs:
        set_up_jax()  # as the command does: what was compiled before is kept
    start, stages = time.perf_counter(), {}

    def progress(stage: str, *_: int) -> None:
        stages.setdefault(stage, round(time.perf_counter() - start, 2))

    with contextlib.closing(engine_for(jobs=jobs)) as engine:
        settings = Settings(k=k)
        result = denoise_file(source, target, settings=settings, tile_points=tile, engine=engine, progress=progress)
        seconds = time.perf_counter() - start
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)  # of the processes the largest; they have ended
    peak = max(resource.getrusage(each).ru_maxrss for each in who) / 2**20
    return {**result._asdict(), "jobs": jobs, "seconds": seconds, "peak_gb": peak, "began_s": stages}


def main() -> None:
    """Measure every size, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100_000, 1_000_000, 10_000_000])
    parser.add_argument("--tile", type=int, default=1 << 18)
    parser.add_argument("--neighbors", type=int, default=100)
    parser.add_argument("--jobs", type=int, nargs="+", default=[0], help="processes; 0: none but the one that leads")
    parser.add_argument(
        "--write",
        action="store_true",
        help=f"write {RESULT}, with --jobs {JOBS_RESULT.name}; leave it out on a busy machine",
    )
    parser.add_argument("--one", nargs=2, metavar=("SOURCE", "TARGET"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one[0], options.one[1], options.tile, options.neighbors, options.jobs[0])))
        return
    rows = []
    for n in options.sizes:
        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder) / "in.laz", Path(folder) / "out.laz"
            write_scan(source, n)
            for jobs in options.jobs:
                command = [sys.executable, "-m", "benchmarks.tiles", "--one", str(source), str(target)]
                command += ["--tile", str(options.tile), "--neighbors", str(options.neighbors), "--jobs", str(jobs)]
                out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
                row = json.loads(out.splitlines()[-1])
                rows.append(row)
                print(
                    f"{n:>11,} {jobs} jobs {row['tiles']:4d} tiles {row['seconds']:8.1f} s {row['peak_gb']:6.2f} GB  "
                    f"{row['began_s']}",
                    flush=True,
                )
    if options.write:
        config = vars(options)
        path = JOBS_RESULT if options.jobs != [0] else RESULT
        record.write(path, {"rows": record.table(rows, config=config)}, seeds=[0], config=config)


if __name__ == "__main__":
    main()
