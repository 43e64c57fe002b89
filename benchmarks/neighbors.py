"""Exact nearest neighbours beside Open3D, SciPy, pykdtree and scikit-learn, in one run: `python -m benchmarks.neighbors`.

Every contender builds its index and finds the k nearest other points of all points of one simulated cable scan. Rounds
alternate between contenders, so that a busy moment of the machine hits all of them; ratios of medians are the result.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.timing import alternate, half_cylinder, open3d_module

RESULT = Path("results/benchmarks/neighbors.json")


def contenders(xyz: np.ndarray, k: int) -> dict[str, Callable[[], np.ndarray]]:
    """Searches by name; each returns squared distances `[n, k]`, the point itself left out."""
    import jax
    import jax.numpy as jnp
    from scipy.spatial import cKDTree

    from cablejax.ops import knn

    points = jnp.asarray(xyz)

    def ours() -> np.ndarray:
        return np.asarray(jax.block_until_ready(knn(points, k=k)).sq_dist)

    def scipy() -> np.ndarray:
        return cKDTree(xyz).query(xyz, k + 1, workers=-1)[0][:, 1:] ** 2

    def open3d() -> np.ndarray:
        core = open3d_module().core
        search = core.nns.NearestNeighborSearch(core.Tensor(xyz))
        search.knn_index()
        return search.knn_search(core.Tensor(xyz), k + 1)[1].numpy()[:, 1:]

    def pykdtree() -> np.ndarray:
        from pykdtree.kdtree import KDTree

        return KDTree(xyz).query(xyz, k + 1)[0][:, 1:] ** 2

    def sklearn() -> np.ndarray:
        from sklearn.neighbors import NearestNeighbors

        return NearestNeighbors(algorithm="kd_tree", n_jobs=-1).fit(xyz).kneighbors(n_neighbors=k)[0] ** 2

    return {"cablejax": ours, "open3d": open3d, "scipy": scipy, "pykdtree": pykdtree, "scikit-learn": sklearn}


def main() -> None:
    """Time all contenders on one cloud, check that they agree, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=53_135)
    parser.add_argument("--k", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--noise-mm", type=float, default=0.385)
    parser.add_argument("--stray-share", type=float, default=0.0)
    parser.add_argument("--write", action="store_true", help=f"write {RESULT}; leave it out on a busy machine")
    options = parser.parse_args()
    xyz = half_cylinder(options.points, noise_mm=options.noise_mm, stray_share=options.stray_share)
    runs = contenders(xyz, options.k)
    start = time.perf_counter()
    expected = runs["scipy"]()
    first = {}
    for name, run in runs.items():
        start = time.perf_counter()
        np.testing.assert_allclose(run(), expected, rtol=1e-4, atol=1e-9, err_msg=name)
        first[name] = time.perf_counter() - start
    alternate("neighbors", runs, first, vars(options), RESULT if options.write else None)


if __name__ == "__main__":
    main()
