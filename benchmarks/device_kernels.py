"""What `benchmarks.device` runs: every kernel at a size, and the NumPy that its result is held against.

A check looks at some rows, measured in float64 against all points, and raises AssertionError where they disagree. Whatever
a kernel computes for one row it computes for all, so rows at random tell whether a device computes it rightly.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import half_cylinder

Run = Callable[[], Any]
Check = Callable[[Any], None]
LARGE, MIDDLE = (100_000, 1_000_000), (100_000,)


class Kernel(NamedTuple):
    """One kernel.

    Attributes:
        name: What it is called in the table.
        sizes: Points at which it is run on an accelerator.
        small: Points at which it is run on a CPU.
        make: From a number of points, the call that is timed and the check of its result.
        beside_ms: Published times of others by size, in ms.
    """

    name: str
    sizes: tuple[int, ...]
    small: int
    make: Callable[[int], tuple[Run, Check]]
    beside_ms: dict[int, float] = {}  # noqa: RUF012  (read only)


def some_rows(n: int, count: int = 64) -> np.ndarray:
    """Rows to check, fewer of large clouds."""
    return np.random.default_rng(1).choice(n, min(n, count if n <= 1_000_000 else 8), replace=False)


def distances(xyz: np.ndarray, place: np.ndarray, box: np.ndarray | None = None) -> np.ndarray:
    """Squared distances from one place to all points in float64."""
    difference = np.abs(xyz - place.astype(np.float64))
    if box is not None:
        difference = np.minimum(difference, box - difference)
    return np.square(difference).sum(axis=1)


def assert_nearest(found: Any, xyz: np.ndarray, k: int, box: np.ndarray | None = None, splits: Any = None) -> None:
    """The k nearest others of some rows."""
    sq_dist, neighbors = np.asarray(found.sq_dist), np.asarray(found.neighbors)
    for row in some_rows(len(xyz)):
        exact = distances(xyz, xyz[row], box)
        exact[row] = np.inf
        if splits is not None:
            cloud = np.searchsorted(splits, row, side="right") - 1
            exact[: splits[cloud]] = exact[splits[cloud + 1] :] = np.inf
        np.testing.assert_allclose(sq_dist[row], np.sort(exact)[:k], rtol=2e-5, atol=1e-9)
        np.testing.assert_allclose(exact[neighbors[row]], np.sort(exact)[:k], rtol=2e-5, atol=1e-9)


def assert_between(count: Any, exact: Callable[[np.ndarray, float], np.ndarray], radius: float) -> None:
    """Counts within a radius, where a pair at that distance to rounding may fall on either side."""
    count = np.asarray(count)
    rows = some_rows(len(count))
    low, high = (exact(rows, radius * scale) for scale in (1 - 1e-6, 1 + 1e-6))
    assert ((low <= count[rows]) & (count[rows] <= high)).all(), (low, count[rows], high)


def within(xyz: np.ndarray) -> Callable[[np.ndarray, float], np.ndarray]:
    """How many points, the row itself counted, lie within a radius of given rows."""
    return lambda rows, radius: np.array([(distances(xyz, xyz[row]) <= radius**2).sum() for row in rows])


def knn(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n, stray_share=0.02)
    points = jnp.asarray(xyz)
    return lambda: ops.knn(points, k=30), lambda found: assert_nearest(found, xyz, 30)


def tree_queries(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n, stray_share=0.02)
    rows = np.random.default_rng(2).choice(n, min(n, 10_000), replace=False)
    tree, queries = ops.build_tree(jnp.asarray(xyz)), jnp.asarray(xyz[rows])

    def check(found: Any) -> None:
        for i in some_rows(len(rows), 32):
            exact = np.sort(distances(xyz, xyz[rows[i]]))[:20]
            np.testing.assert_allclose(np.asarray(found.sq_dist)[i], exact, rtol=2e-5, atol=1e-9)

    return lambda: ops.query(tree, queries, k=20), check


def ragged(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n, stray_share=0.02)
    cuts = np.sort(np.random.default_rng(3).choice(np.arange(1, n), 15, replace=False))
    splits = np.concatenate([[0], cuts, [n]]).astype(np.int32)
    points, given = jnp.asarray(xyz), jnp.asarray(splits)
    return lambda: ops.knn(points, k=20, row_splits=given), lambda found: assert_nearest(found, xyz, 20, splits=splits)


def periodic(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = np.random.default_rng(4).random((n, 3)).astype(np.float32)
    points, box = jnp.asarray(xyz), jnp.ones(3)
    return lambda: ops.knn(points, k=20, box=box), lambda found: assert_nearest(found, xyz, 20, box=np.ones(3))


def counts(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n, stray_share=0.02)
    points = jnp.asarray(xyz)

    def check(found: Any) -> None:
        assert_between(found.count, within(xyz), 1.0)

    return lambda: ops.radius_count(points, radius=1.0, include_self=True), check


def radius_graph(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n)
    points = jnp.asarray(xyz)

    def check(graph: Any) -> None:
        senders, receivers = np.asarray(graph.senders), np.asarray(graph.receivers)
        count = np.bincount(receivers[receivers >= 0], minlength=n)
        kept = count < 32  # of the others only the nearest 32 are kept
        assert int(graph.most) >= count.max()
        rows = some_rows(n)
        low, high = (within(xyz)(rows, 0.7 * scale) - 1 for scale in (1 - 1e-6, 1 + 1e-6))
        assert (~kept[rows] | ((low <= count[rows]) & (count[rows] <= high))).all()
        edges = np.random.default_rng(5).choice(int(graph.count), 1000)
        exact = np.square(xyz[senders[edges]].astype(np.float64) - xyz[receivers[edges]]).sum(axis=1)
        np.testing.assert_allclose(np.asarray(graph.sq_dist)[edges], exact, rtol=2e-5, atol=1e-9)

    return lambda: ops.radius_graph(points, radius=0.7, max_neighbors=32), check


def farthest(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n)
    points = jnp.asarray(xyz)

    def check(sample: Any) -> None:
        rows, sq_dist = np.asarray(sample.rows), np.asarray(sample.sq_dist)
        nearest = np.full(n, np.inf)
        for step, row in enumerate(rows[:200]):
            if step:
                np.testing.assert_allclose([nearest.max(), nearest[row]], sq_dist[step], rtol=1e-5)
            nearest = np.minimum(nearest, distances(xyz, xyz[row]))

    return lambda: ops.farthest_point_sampling(points, count=512), check


def balls(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n)
    points, queries = jnp.asarray(xyz), jnp.asarray(xyz[: min(n, 4096)])

    def check(found: Any) -> None:
        for row in some_rows(min(n, 4096)):
            exact = distances(xyz, xyz[row])
            if (np.abs(np.sqrt(exact) - 1.0) > 1e-5).all():
                rows = np.flatnonzero(exact <= 1.0)
                assert int(found.count[row]) == len(rows)
                assert found.neighbors[row][: len(rows)].tolist() == rows[:32].tolist()

    return lambda: ops.ball_query(points, queries, radius=1.0, capacity=32), check


def voxels(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n)
    points, origin = jnp.asarray(xyz), jnp.zeros(3)

    def check(found: Any) -> None:
        cells = np.floor(xyz)  # voxels of side 1 from the origin: exact in float32
        unique, count = np.unique(cells, axis=0, return_counts=True)
        assert int(found.total) == len(unique)
        np.testing.assert_array_equal(np.asarray(found.count)[: len(unique)], count)
        for number in some_rows(len(unique)):
            mean = xyz[(cells == unique[number]).all(axis=1)].astype(np.float64).mean(axis=0)
            np.testing.assert_allclose(found.xyz[number], mean, atol=1e-4)

    return lambda: ops.voxel_downsample(points, size=1.0, origin=origin), check


def normals(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n)
    points, inside = jnp.asarray(xyz), jnp.array([0.0, 0.0, 150.0])

    def check(found: Any) -> None:
        for row in some_rows(n):
            near = np.argsort(distances(xyz, xyz[row]))[:21]
            around = xyz[near].astype(np.float64)
            values, vectors = np.linalg.eigh(np.cov(around.T))
            if values[1] - values[0] > 0.05 * values[2]:  # two that are nearly equal leave the direction open
                assert abs(float(np.asarray(found.normals[row]) @ vectors[:, 0])) > 0.999

    return lambda: ops.estimate_normals(points, k=20, viewpoint=inside), check


def signs(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops

    xyz = half_cylinder(n, noise_mm=0.02)
    points = jnp.asarray(xyz)
    found = ops.knn(points, k=10)
    given = ops.estimate_normals(points, found=found).normals

    def check(oriented: Any) -> None:
        outwards = (np.sum(np.asarray(oriented)[:, :2] * xyz[:, :2], axis=1) > 0).mean()
        assert not 0.01 < outwards < 0.99, outwards  # all outwards or all inwards: up and down are level here

    return lambda: ops.orient_normals(points, given, found.neighbors), check


def removal(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops
    from cablejax.types import PointCloud

    xyz = half_cylinder(n, stray_share=0.02)
    cloud = PointCloud(jnp.asarray(xyz), jnp.ones(n, dtype=bool))

    def check(found: Any) -> None:
        score = np.asarray(found.score)
        for row in some_rows(n):
            exact = np.sqrt(np.sort(distances(xyz, xyz[row]))[:20]).mean()
            np.testing.assert_allclose(score[row], exact, rtol=1e-4)
        exact = score.astype(np.float64)
        threshold = exact.mean() + 2.0 * exact.std(ddof=1)
        np.testing.assert_allclose(found.threshold, threshold, rtol=1e-3)
        np.testing.assert_array_equal(found.keep, score < np.asarray(found.threshold))

    return lambda: ops.statistical_outliers(cloud, k=20), check


def medians(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops
    from cablejax.types import PointCloud

    xyz = half_cylinder(n, stray_share=0.02)
    cloud = PointCloud(jnp.asarray(xyz), jnp.ones(n, dtype=bool))

    def check(found: Any) -> None:
        for row in some_rows(n):
            near = np.argsort(distances(xyz, xyz[row]))[1:21]
            exact = np.linalg.norm(xyz[row] - np.median(xyz[near].astype(np.float64), axis=0))
            np.testing.assert_allclose(found.score[row], exact, rtol=1e-3, atol=1e-4)

    return lambda: ops.median_outliers(cloud, k=20), check


def adaptive(order: int) -> Callable[[int], tuple[Run, Check]]:
    def make(n: int) -> tuple[Run, Check]:
        import jax.numpy as jnp

        from cablejax import ops
        from cablejax.types import PointCloud
        from tests.reference.filters import adaptive_filter

        given = {"k": 20, "alpha": 0.4, "beta": 0.3, "gamma": 0.1, "tau": 6.0, "order": order, "refinements": 0}
        cloud = PointCloud(jnp.asarray(half_cylinder(n)), jnp.ones(n, dtype=bool))

        def check(found: Any) -> None:
            assert np.isfinite(np.asarray(found.xyz)).all()
            few = half_cylinder(300)
            ours = ops.adaptive_filter(PointCloud(jnp.asarray(few), jnp.ones(300, dtype=bool)), **given)
            theirs, _ = adaptive_filter(few, **given)
            # Fits whose neighbours do not determine them fall back, in the kernel alone.
            sure = np.asarray(ours.status) == 0
            apart = np.linalg.norm(np.asarray(ours.xyz) - theirs, axis=1)[sure]
            assert np.quantile(apart, 0.9) < 5e-3, np.quantile(apart, [0.5, 0.9, 1.0])

        return lambda: ops.adaptive_filter(cloud, **given), check

    return make


def cleaning(n: int) -> tuple[Run, Check]:
    import jax.numpy as jnp

    from cablejax import ops
    from cablejax.types import PointCloud

    xyz = half_cylinder(n, stray_share=0.02)
    cloud = PointCloud(jnp.asarray(xyz), jnp.ones(n, dtype=bool))

    def check(found: Any) -> None:
        keep = np.asarray(found.keep)
        before, after = (np.hypot(p[:, 0], p[:, 1])[keep] - 15.0 for p in (xyz, np.asarray(found.xyz)))
        middle = (np.abs(xyz[keep][:, 2] - xyz[keep][:, 2].mean()) < 0.4 * np.ptp(xyz[keep][:, 2])) & (
            xyz[keep][:, 1] > 5
        )
        assert np.abs(after[middle]).mean() < 0.5 * np.abs(before[middle]).mean()

    return lambda: ops.clean(cloud, k=100, order=2), check


def features(n: int) -> tuple[Run, Check]:
    import jax
    import jax.numpy as jnp

    from cablejax import ops

    rows = np.random.default_rng(6).normal(size=(n // 1024, 1024, 64)).astype(np.float32)
    given = jnp.asarray(rows)
    search = jax.jit(jax.vmap(lambda rows: ops.knn_features(rows, k=20)))

    def check(found: Any) -> None:
        for cloud in range(len(rows)):
            one = type(found)(*(np.asarray(part)[cloud] for part in found))
            if cloud < 4:
                assert_nearest(one, rows[cloud], 20)

    return lambda: search(given), check


def edges(n: int) -> tuple[Run, Check]:
    import jax
    import jax.numpy as jnp

    from cablejax import ops
    from tests.reference.edges import edge_conv

    rng = np.random.default_rng(7)
    rows = jnp.asarray(rng.normal(size=(n // 1024, 1024, 64)), dtype=jnp.float32)
    kernel = jnp.asarray(rng.normal(size=(128, 64)) * 0.1, dtype=jnp.float32)
    ones, zeros = jnp.ones(64), jnp.zeros(64)

    def conv(rows: Any, neighbors: Any) -> Any:
        return ops.edge_conv(rows, neighbors, kernel, scale=ones, shift=zeros)

    def layer(rows: Any) -> Any:
        return conv(rows, ops.feature_graph(rows, k=20))

    run = jax.jit(jax.vmap(layer))

    def check(found: Any) -> None:
        assert np.isfinite(np.asarray(found)).all()
        few = rows[0, :40]
        graph = ops.feature_graph(few, k=5)
        exact = edge_conv(np.asarray(few, np.float64), np.asarray(graph), np.asarray(kernel, np.float64), 1.0, 0.0)
        np.testing.assert_allclose(conv(few, graph), exact, rtol=1e-2, atol=2e-2)

    return lambda: run(rows), check


def eigen(n: int) -> tuple[Run, Check]:
    import jax
    import jax.numpy as jnp

    from cablejax import ops

    half = np.random.default_rng(8).normal(size=(n, 3, 3)).astype(np.float32)
    given = jnp.asarray(half + half.transpose(0, 2, 1))
    run = jax.jit(ops.symmetric_eigen)

    def check(found: Any) -> None:
        rows = some_rows(n, 1000)
        exact = np.linalg.eigvalsh(np.asarray(given, dtype=np.float64)[rows])
        np.testing.assert_allclose(np.asarray(found.values)[rows], exact, atol=2e-5)

    return lambda: run(given), check


def train_step(n: int) -> tuple[Run, Check]:
    from benchmarks.train_step import batch, ours

    step, _ = ours("adgcnn", batch(max(2, n // 1024), 1024), 20)

    def check(loss: Any) -> None:
        assert np.isfinite(loss), loss

    return step, check


# Those that decide most come first: what the time does not reach is said and left out. jz-tree's figures are its authors',
# for k 30 on an A100.
KERNELS = (
    Kernel("knn k 30", (*LARGE, 10_000_000), 4000, knn, {100_000: 4.2, 1_000_000: 14.0, 10_000_000: 117.0}),
    Kernel("statistical_outliers k 20", LARGE, 4000, removal),
    Kernel("train step ADGCNN, clouds of 1,024", (16_384,), 2048, train_step),
    Kernel("knn_features, clouds of 1,024", (16_384,), 2048, features),
    Kernel("edge_conv, clouds of 1,024", (16_384,), 2048, edges),
    Kernel("clean order 2 k 100", MIDDLE, 4000, cleaning),
    Kernel("query 10,000 of a tree, k 20", LARGE, 4000, tree_queries),
    Kernel("radius_count", LARGE, 4000, counts),
    Kernel("radius_graph 32", MIDDLE, 4000, radius_graph),
    Kernel("knn of 16 ragged clouds, k 20", LARGE, 4000, ragged),
    Kernel("knn in a periodic box, k 20", MIDDLE, 4000, periodic),
    Kernel("estimate_normals k 20", LARGE, 4000, normals),
    Kernel("orient_normals k 10", MIDDLE, 2000, signs),
    Kernel("voxel_downsample", LARGE, 4000, voxels),
    Kernel("farthest_point_sampling 512", MIDDLE, 4000, farthest),
    Kernel("ball_query 4,096 balls of 32", MIDDLE, 4000, balls),
    Kernel("adaptive_filter order 0", MIDDLE, 2000, adaptive(0)),
    Kernel("adaptive_filter order 1", MIDDLE, 2000, adaptive(1)),
    Kernel("adaptive_filter order 2", MIDDLE, 2000, adaptive(2)),
    Kernel("median_outliers k 20", MIDDLE, 4000, medians),
    Kernel("symmetric_eigen", LARGE, 4000, eigen),
)
