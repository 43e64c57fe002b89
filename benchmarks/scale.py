"""Statistical removal from 1e5 points upwards beside Open3D, and others' bare searches: `python -m benchmarks.scale`.

Each size and contender runs in a process of its own, so that the peak of its memory is its own. Ours runs twice: once
compiling, for the seconds of a first call, and once from the compilation cache, for run time and peak memory.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import record
from benchmarks.timing import half_cylinder, open3d_module

RESULT = Path("results/benchmarks/scale.json")


K = 20


def contender(name: str, xyz: np.ndarray) -> Callable[[], int]:
    """A removal, or a bare search with as many neighbours; returns a number of points."""
    if name == "open3d":
        open3d = open3d_module()
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz.astype(np.float64)))
        return lambda: len(cloud.remove_statistical_outlier(K, 2.0)[1])
    if name == "scipy search":
        from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

        return lambda: len(cKDTree(xyz).query(xyz, K, workers=-1)[0])
    if name == "pykdtree search":
        from pykdtree.kdtree import KDTree

        return lambda: len(KDTree(xyz).query(xyz, K)[0])
    import jax.numpy as jnp

    from cablejax.ops import statistical_outliers
    from cablejax.types import PointCloud

    ours = PointCloud(jnp.asarray(xyz), jnp.ones(len(xyz), dtype=bool))
    return lambda: int(statistical_outliers(ours, k=K).keep.sum())


def measure(name: str, n: int) -> dict[str, float]:
    """Seconds of the first and of a later call, and peak memory in GB: of the process, and before the first call."""
    run = contender(name, half_cylinder(n, stray_share=0.02))
    seconds, before = [], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(3):
        start = time.perf_counter()
        count = run()
        seconds.append(time.perf_counter() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    gb = 2.0**20
    return {
        "first_s": seconds[0],
        "run_s": min(seconds[1:]),
        "peak_gb": peak / gb,
        "before_gb": before / gb,
        "count": count,
    }


def in_process(name: str, n: int, cache: str) -> dict[str, float]:
    """`measure` in a process of its own, with a folder for what it compiles."""
    command = [sys.executable, "-m", "benchmarks.scale", "--one", name, str(n)]
    settings = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | settings, check=False)
    if done.returncode:
        raise SystemExit(f"{name}, {n} points: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def row_of(name: str, n: int) -> dict[str, Any]:
    """One row of the table."""
    with tempfile.TemporaryDirectory() as cache:
        cold = in_process(name, n, cache)
        row = in_process(name, n, cache) if name == "cablejax" else cold
    added = row["peak_gb"] - row["before_gb"]
    print(
        f"{n:>10,} {name:16s}{row['run_s']:8.2f} s  first {cold['first_s']:6.2f} s  "
        f"peak {row['peak_gb']:.2f} GB, of the call {added:.2f} GB",
        flush=True,
    )
    return {"points": n, "contender": name, **row, "first_s": cold["first_s"], "compiling_gb": cold["peak_gb"]}


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
    names = ("cablejax", "open3d", "scipy search", "pykdtree search")
    rows = [row_of(name, n) for n in options.sizes for name in names]
    if options.write:
        config = {"sizes": options.sizes, "k": K}
        record.write(RESULT, {"rows": record.table(rows, config=config)}, seeds=[0], config=config)


if __name__ == "__main__":
    main()
