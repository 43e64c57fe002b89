"""Exact nearest neighbours and statistical removal beside Open3D, SciPy, pykdtree and scikit-learn, in one run.

    python -m benchmarks.neighbors --write

Every contender builds its index and finds the k nearest other points of all points of one simulated cable scan; then
statistical removal with the same k, ours and Open3D's. Rounds alternate between contenders, so that a busy moment of the
machine hits all of them; ratios of medians are the result. jaxkd takes minutes at this size and joins up to 5,000 points.
Last, a batch of small clouds in a feature space beside `lax.top_k` over a matrix product, and torch where it is installed.
"""

import argparse
import importlib.util
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks.timing import alternate, cable_scan, open3d_module

RESULTS = Path("results/benchmarks")
JAXKD_POINTS = 5000


def contenders(xyz: np.ndarray, k: int) -> dict[str, Callable[[], np.ndarray]]:
    """Searches by name; each returns squared distances `[n, k]`, the point itself left out."""
    import jax
    import jax.numpy as jnp
    from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

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

    def jaxkd() -> np.ndarray:
        from jaxkd import build_and_query

        return np.asarray(jax.block_until_ready(build_and_query(points, points, k=k + 1))[1])[:, 1:] ** 2

    runs = {"cablejax": ours, "open3d": open3d, "scipy": scipy, "pykdtree": pykdtree, "scikit-learn": sklearn}
    return runs | ({"jaxkd": jaxkd} if len(xyz) <= JAXKD_POINTS else {})


def removals(xyz: np.ndarray, k: int) -> dict[str, Callable[[], int]]:
    """Statistical removals by name; each returns how many points it keeps."""
    import jax.numpy as jnp

    from cablejax.ops import statistical_outliers
    from cablejax.types import PointCloud

    open3d = open3d_module()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz.astype(np.float64)))
    ours = PointCloud(jnp.asarray(xyz), jnp.ones(len(xyz), dtype=bool))
    return {
        "cablejax": lambda: int(statistical_outliers(ours, k=k).keep.sum()),
        "open3d": lambda: len(cloud.remove_statistical_outlier(k, 2.0)[1]),
    }


def feature_searches(clouds: int, n: int, channels: int, k: int) -> dict[str, Callable[[], np.ndarray]]:
    """Searches in a batch of feature matrices by name; each returns squared distances `[clouds, n, k]`."""
    import jax
    import jax.numpy as jnp

    from cablejax.ops import knn_features

    features = np.random.default_rng(0).normal(size=(clouds, n, channels)).astype(np.float32)
    on_device = jnp.asarray(features)
    ours = jax.jit(jax.vmap(lambda rows: knn_features(rows, k=k).sq_dist))

    @jax.jit
    @jax.vmap
    def top_k(rows: jax.Array) -> jax.Array:
        norm = jnp.square(rows).sum(axis=1)
        sq_dist = norm[:, None] - 2.0 * rows @ rows.T + norm[None, :]
        return -jax.lax.top_k(-jnp.where(jnp.eye(n, dtype=bool), jnp.inf, sq_dist), k)[0]

    runs = {"cablejax": lambda: np.asarray(ours(on_device)), "top_k": lambda: np.asarray(top_k(on_device))}
    if importlib.util.find_spec("torch"):
        import torch

        tensor = torch.from_numpy(features)
        runs["torch"] = lambda: torch.cdist(tensor, tensor).topk(k + 1, largest=False)[0].numpy()[..., 1:] ** 2
    return runs


def agree(runs: Mapping[str, Callable[[], np.ndarray]], expected: np.ndarray, rtol: float) -> dict[str, float]:
    """Seconds of each contender's first call; an error where one finds other distances."""
    first = {}
    for name, run in runs.items():
        start = time.perf_counter()
        found = run()
        first[name] = time.perf_counter() - start
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=1e-9, err_msg=name)
    return first


def main() -> None:
    """Time all contenders on one cloud, check that they agree, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=53_135)
    parser.add_argument("--k", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--preset", default="line-laser", help="scanner of the simulated scan")
    parser.add_argument("--write", action="store_true", help=f"write to {RESULTS}; leave it out on a busy machine")
    options = parser.parse_args()
    xyz = cable_scan(options.points, preset=options.preset)
    runs, removing = contenders(xyz, options.k), removals(xyz, options.k)
    first, first_removal = agree(runs, runs["scipy"](), 1e-4), {}
    for name, run in removing.items():
        start = time.perf_counter()
        kept = run()
        first_removal[name] = time.perf_counter() - start
        print(f"{name} keeps {kept} points")
    config = {name: value for name, value in vars(options).items() if name != "write"}
    path = RESULTS if options.write else None
    alternate("neighbors", runs, first, config, path and path / f"neighbors_{options.points}.json")
    alternate("statistical removal", removing, first_removal, config, path and path / f"removal_{options.points}.json")
    shape = {"clouds": 16, "points": 1024, "channels": 64, "k": options.k, "rounds": options.rounds}
    searches = feature_searches(16, 1024, 64, options.k)
    first = agree(searches, searches["top_k"](), 1e-3)
    alternate("features", searches, first, shape, path and path / "neighbors_features.json")


if __name__ == "__main__":
    main()
