"""Outlier removal and the adaptive filter beside Open3D's statistical removal: `python -m benchmarks.filters`."""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import alternate, half_cylinder, open3d_module

RESULT = Path("results/benchmarks/filters.json")


def contenders(xyz: np.ndarray, k: int) -> dict[str, Callable[[], Any]]:
    """Removals and filters by name."""
    import jax
    import jax.numpy as jnp

    from cablejax.ops import clean, statistical_outliers
    from cablejax.types import PointCloud

    cloud = PointCloud(jnp.asarray(xyz), jnp.ones(len(xyz), dtype=bool))

    def removal() -> np.ndarray:
        return np.asarray(statistical_outliers(cloud, k=k).keep)

    def whole(order: int) -> np.ndarray:
        return np.asarray(jax.block_until_ready(clean(cloud, removal_k=k, k=k, order=order).xyz))

    open3d = open3d_module()
    theirs = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz.astype(np.float64)))
    return {
        "removal + order 0": lambda: whole(0),
        "statistical removal": removal,
        "open3d statistical": lambda: theirs.remove_statistical_outlier(k, 2.0)[1],
        "removal + order 2": lambda: whole(2),
    }


def main() -> None:
    """Check that both removals keep the same points, time all contenders, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=53_135)
    parser.add_argument("--k", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--stray-share", type=float, default=0.02)
    parser.add_argument("--write", action="store_true", help=f"write {RESULT}; leave it out on a busy machine")
    options = parser.parse_args()
    xyz = half_cylinder(options.points, stray_share=options.stray_share)
    runs, first, results = contenders(xyz, options.k), {}, {}
    for name, run in runs.items():
        start = time.perf_counter()
        results[name] = run()
        first[name] = time.perf_counter() - start
    kept = np.zeros(len(xyz), dtype=bool)
    kept[np.asarray(results["open3d statistical"])] = True
    differing = int((kept != results["statistical removal"]).sum())
    print(f"points on which the removals differ: {differing} of {len(xyz)}")
    config = {**vars(options), "differing": differing}
    alternate("filters", runs, first, config, RESULT if options.write else None)


if __name__ == "__main__":
    main()
