"""Statistical removal from 1e5 points upwards beside Open3D, with peak memory: `python -m benchmarks.scale`.

Each size and contender runs in a process of its own, so that the peak is its own; ours is timed after a first call.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import half_cylinder, open3d_module

RESULT = Path("results/benchmarks/scale.json")


def measure(contender: str, n: int) -> dict[str, float]:
    """Seconds of the first and of a later call, and the process's peak memory above its imports."""
    xyz = half_cylinder(n, stray_share=0.02)
    if contender == "open3d":
        open3d = open3d_module()
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz.astype(np.float64)))

        def run() -> int:
            return len(cloud.remove_statistical_outlier(20, 2.0)[1])
    else:
        import jax.numpy as jnp

        from cablejax.ops import statistical_outliers
        from cablejax.types import PointCloud

        ours = PointCloud(jnp.asarray(xyz), jnp.ones(n, dtype=bool))

        def run() -> int:
            return int(statistical_outliers(ours, k=20).keep.sum())

    seconds = []
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(2):
        start = time.perf_counter()
        kept = run()
        seconds.append(time.perf_counter() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "first_s": seconds[0],
        "run_s": seconds[1],
        "peak_gb": peak / 2**20,
        "imports_gb": before / 2**20,
        "kept": kept,
    }


def main() -> None:
    """Measure every size in processes of its own, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100_000, 300_000, 1_000_000, 3_000_000])
    parser.add_argument("--write", action="store_true", help=f"write {RESULT}; leave it out on a busy machine")
    parser.add_argument("--one", nargs=2, metavar=("CONTENDER", "N"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one[0], int(options.one[1]))))
        return
    rows = []
    for n in options.sizes:
        for contender in ("cablejax", "open3d"):
            command = [sys.executable, "-m", "benchmarks.scale", "--one", contender, str(n)]
            out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            rows.append({"points": n, "contender": contender, **json.loads(out.splitlines()[-1])})
            row = rows[-1]
            print(
                f"{n:>10,} {contender:10s} {row['run_s']:8.2f} s  first {row['first_s']:6.2f} s  {row['peak_gb']:.2f} GB"
            )
    if options.write:
        from cablejax.io.provenance import provenance, write_json

        RESULT.parent.mkdir(parents=True, exist_ok=True)
        write_json(RESULT, {"rows": rows, "provenance": provenance(seeds=[0], config={"sizes": options.sizes})})


if __name__ == "__main__":
    main()
