"""kNN and radius search against NumPy float64 and SciPy, and the laws they obey."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import knn, knn_features, radius_count, radius_search
from cablejax.types import Status
from tests.reference import neighbors as reference

K = 7
SMALL = 260  # compares all pairs
LARGE = 2500  # builds a tree


def rng():
    return np.random.default_rng(7)


def surface(n, noise=0.3):
    """A noisy half-cylinder, as a scanner sees a cable."""
    r = rng()
    angle, radius = r.uniform(0, np.pi, n), 15 + noise * r.normal(size=n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), r.uniform(0, 100, n)], axis=1).astype(np.float32)


def lattice(n):
    side = int(np.ceil(n ** (1 / 3)))
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return rng().permutation(grid.astype(np.float32))[:n]


def uneven(n):
    """Half the points in a thousandth of the extent, a few far away."""
    dense = rng().normal(size=(n // 2, 3)) * 1e-3
    sparse = rng().normal(size=(n - n // 2, 3)) * 5
    sparse[:20] *= 100
    return np.concatenate([dense, sparse]).astype(np.float32)


CLOUDS = {
    "volume": lambda n: rng().random((n, 3)).astype(np.float32),
    "surface": surface,
    "ties": lattice,
    "duplicates": lambda n: np.repeat(lattice(-(-n // 6)), 6, axis=0)[:n],
    "all equal": lambda n: np.full((n, 3), 2.5, dtype=np.float32),
    "line": lambda n: np.outer(rng().permutation(n), [1.0, 0.0, 0.0]).astype(np.float32),
    "plane": lambda n: (rng().random((n, 3)) * [1, 1, 0]).astype(np.float32),
    "uneven": uneven,
    "far away": lambda n: (rng().random((n, 3)) + np.array([1e4, -1e4, 1e4])).astype(np.float32),
}


def assert_same(result, expected, rtol=4e-7):
    """Same distances to float32 rounding (three products, two sums: 4 ulp), and same rows where distances are apart."""
    neighbors, sq_dist = (np.asarray(a) for a in result[:2])
    rows, exact = expected
    np.testing.assert_array_equal(neighbors < 0, rows < 0)
    np.testing.assert_allclose(sq_dist, exact, rtol=rtol, atol=1e-37)
    wrong = (neighbors != rows) & np.isfinite(exact)
    if wrong.any():  # only ever two points that float32 cannot tell apart
        gap = np.diff(exact, axis=1, prepend=-1.0, append=np.inf)
        close = (np.minimum(gap[:, :-1], gap[:, 1:]) < 1e-6 * exact) & ~_tied(exact)
        assert close[wrong].all()


def _tied(exact):
    same = np.diff(exact, axis=1) == 0
    return np.pad(same, ((0, 0), (1, 0))) | np.pad(same, ((0, 0), (0, 1)))


@pytest.mark.parametrize("name", CLOUDS)
def test_small_clouds_equal_the_reference(name):
    xyz = CLOUDS[name](SMALL)
    assert_same(knn(jnp.asarray(xyz), k=K), reference.knn(xyz, K))


@pytest.mark.parametrize("name", CLOUDS)
def test_tree_equals_the_reference(name):
    xyz = CLOUDS[name](LARGE)
    result = knn(jnp.asarray(xyz), k=K)
    some = rng().choice(LARGE, 200, replace=False)
    rows, exact = reference.knn(xyz, K + 1, queries=xyz[some])
    # The reference finds the point itself too: leave it out by its row.
    keep = np.stack([row != i if (row == i).any() else np.arange(K + 1) < K for row, i in zip(rows, some, strict=True)])
    expected = rows[keep].reshape(-1, K), exact[keep].reshape(-1, K)
    assert_same((result.neighbors[some], result.sq_dist[some]), expected)
    assert not np.asarray(result.status).any()


def test_tree_agrees_with_scipy_at_every_row():
    xyz = surface(LARGE)
    distance, _ = cKDTree(xyz.astype(np.float64)).query(xyz.astype(np.float64), K + 1)
    np.testing.assert_allclose(np.sqrt(knn(jnp.asarray(xyz), k=K).sq_dist), distance[:, 1:], rtol=1e-6)


@pytest.mark.parametrize("n", [SMALL, LARGE])
def test_padding_and_values_that_are_not_finite_change_nothing(n):
    xyz = CLOUDS["volume"](n)
    mask = rng().random(n) < 0.6
    mask[5] = True
    padded = np.where(mask[:, None], xyz, rng().choice([np.nan, np.inf, 0.5], size=(n, 3))).astype(np.float32)
    padded[5] = np.nan
    good = mask.copy()
    good[5] = False
    result = knn(jnp.asarray(padded), k=K, mask=jnp.asarray(mask))
    alone = knn(jnp.asarray(np.where(good[:, None], xyz, 0)), k=K, mask=jnp.asarray(good))
    np.testing.assert_array_equal(result.neighbors, alone.neighbors)
    np.testing.assert_array_equal(result.sq_dist, alone.sq_dist)
    rows, _ = reference.knn(xyz[good], K)
    np.testing.assert_array_equal(np.asarray(result.neighbors)[good], np.flatnonzero(good)[rows])
    assert (np.asarray(result.neighbors)[~good] == -1).all()
    assert np.asarray(result.status)[5] == Status.NOT_FINITE
    assert not np.asarray(result.status)[~np.isin(np.arange(n), 5)].any()


@pytest.mark.parametrize("n", [SMALL, LARGE])  # the large one searches with a tree of queries
def test_queries_apart_from_the_points(n):
    xyz, queries = CLOUDS["volume"](n), rng().normal(size=(300, 3)).astype(np.float32)
    assert_same(knn(jnp.asarray(xyz), k=K, queries=jnp.asarray(queries)), reference.knn(xyz, K, queries=queries))


def test_include_self_puts_the_point_first():
    xyz = CLOUDS["volume"](SMALL)
    result = knn(jnp.asarray(xyz), k=K, include_self=True)
    np.testing.assert_array_equal(result.neighbors[:, 0], np.arange(SMALL))
    assert_same(result, reference.knn(xyz, K, include_self=True))


@pytest.mark.parametrize("n", [1, 2, 5])
def test_too_few_points_is_a_status(n):
    xyz = CLOUDS["volume"](n)
    result = knn(jnp.asarray(xyz), k=K)
    assert_same(result, reference.knn(xyz, K))
    assert (np.asarray(result.status) == Status.TOO_FEW_NEIGHBORS).all()


def test_empty_cloud_has_no_neighbors():
    result = knn(jnp.zeros((SMALL, 3)), k=K, mask=jnp.zeros(SMALL, dtype=bool))
    assert (np.asarray(result.neighbors) == -1).all()
    assert np.isinf(np.asarray(result.sq_dist)).all()


def test_the_nearest_neighbours_do_not_depend_on_rotation_or_order():
    xyz = CLOUDS["volume"](SMALL)
    rotation = np.linalg.qr(rng().normal(size=(3, 3)))[0]
    plain = np.asarray(knn(jnp.asarray(xyz), k=K).neighbors)
    turned = knn(jnp.asarray((xyz @ rotation).astype(np.float32)), k=K).neighbors
    np.testing.assert_array_equal(turned, plain)
    order = rng().permutation(SMALL)
    shuffled = np.asarray(knn(jnp.asarray(xyz[order]), k=K).neighbors)
    np.testing.assert_array_equal(order[shuffled], plain[order])


def test_translation_by_1e4_keeps_neighbours_of_a_lattice():
    # Whole numbers and their distances are exact in float32 up to 2^24.
    xyz = lattice(SMALL)
    moved = knn(jnp.asarray(xyz + np.float32(1e4)), k=K)
    plain = knn(jnp.asarray(xyz), k=K)
    np.testing.assert_array_equal(moved.neighbors, plain.neighbors)
    np.testing.assert_array_equal(moved.sq_dist, plain.sq_dist)


@pytest.mark.parametrize("n", [SMALL, LARGE])
def test_vmap_equals_loop_and_does_not_retrace(n):
    traces = []

    @jax.jit
    def batched(clouds):
        traces.append(1)
        return jax.vmap(lambda xyz: knn(xyz, k=K))(clouds)

    clouds = jnp.asarray(np.stack([surface(n), CLOUDS["volume"](n)]))
    together = batched(clouds)
    for i in range(2):
        single = knn(clouds[i], k=K)
        np.testing.assert_array_equal(together.neighbors[i], single.neighbors)
        np.testing.assert_allclose(together.sq_dist[i], single.sq_dist, rtol=4e-7)
    batched(clouds + 1.0)
    assert len(traces) == 1


def test_gradient_of_distances():
    xyz = jnp.asarray(CLOUDS["volume"](SMALL))
    neighbors = knn(xyz, k=K).neighbors

    def through_search(points):
        return jnp.sum(jnp.sqrt(1e-3 + knn(points, k=K).sq_dist))

    def direct(points):
        difference = points[:, None] - points[neighbors]
        return jnp.sum(jnp.sqrt(1e-3 + jnp.square(difference).sum(axis=-1)))

    np.testing.assert_allclose(jax.grad(through_search)(xyz), jax.grad(direct)(xyz), rtol=1e-4, atol=1e-4)


def test_gradient_of_a_radius_search():
    xyz = jnp.asarray(CLOUDS["volume"](SMALL))
    found = radius_search(xyz, radius=0.2, capacity=8)
    inside = np.asarray(found.neighbors) >= 0

    def through_search(x):
        return jnp.sum(jnp.where(inside, radius_search(x, radius=0.2, capacity=8).sq_dist, 0.0))

    def direct(x):
        return jnp.sum(jnp.where(inside, jnp.square(x[:, None] - x[np.maximum(found.neighbors, 0)]).sum(axis=-1), 0.0))

    np.testing.assert_allclose(jax.grad(through_search)(xyz), jax.grad(direct)(xyz), rtol=1e-4, atol=1e-5)


def test_gradient_is_finite_with_padding_and_duplicates():
    xyz = jnp.asarray(np.where(np.arange(SMALL)[:, None] < 5, np.nan, CLOUDS["duplicates"](SMALL)))
    mask = jnp.arange(SMALL) >= 5
    gradient = jax.grad(lambda x: jnp.sum(jnp.where(mask[:, None], knn(x, k=K, mask=mask).sq_dist, 0.0)))(xyz)
    assert np.isfinite(np.asarray(gradient)).all()


@pytest.mark.parametrize("channels", [3, 16, 64])
def test_features_equal_the_reference(channels):
    features = rng().normal(size=(SMALL, channels)).astype(np.float32) + 100
    # c sums of one rounding each: the bound grows with the number of channels.
    expected = reference.knn(features, K)
    assert_same(knn_features(jnp.asarray(features), k=K), expected, rtol=channels * 2e-7)


@pytest.mark.parametrize("kind", ["heaps", "far from the origin", "one value"])
def test_features_that_a_product_cannot_tell_apart(kind):
    """Heaps of near points far from each other, where the rounding of |x|^2 - 2xy + |y|^2 exceeds the distances."""
    features = rng().normal(size=(SMALL, 16))
    if kind == "heaps":
        features = features * 1e-3 + 100.0 * (np.arange(SMALL) % 3)[:, None]
    if kind == "far from the origin":
        features = features + 1e4
    if kind == "one value":
        features = np.ones_like(features)
    features = features.astype(np.float32)
    assert_same(knn_features(jnp.asarray(features), k=K), reference.knn(features, K), rtol=16 * 2e-7)


def test_as_many_neighbours_as_are_allowed():
    xyz = surface(LARGE)
    distance, _ = cKDTree(xyz.astype(np.float64)).query(xyz.astype(np.float64), 129)
    np.testing.assert_allclose(np.sqrt(knn(jnp.asarray(xyz), k=128).sq_dist), distance[:, 1:], rtol=1e-6)


@pytest.mark.parametrize("name", ["volume", "ties", "duplicates", "uneven"])
def test_radius_search_equals_the_reference(name):
    xyz = CLOUDS[name](SMALL)
    radius = {"volume": 0.2, "ties": 1.0, "duplicates": 1.0, "uneven": 0.5}[name]
    tree = cKDTree(xyz.astype(np.float64))
    count = tree.query_ball_point(xyz.astype(np.float64), radius, return_length=True) - 1
    np.testing.assert_array_equal(radius_count(jnp.asarray(xyz), radius=radius).count, count)
    result = radius_search(jnp.asarray(xyz), radius=radius, capacity=8)
    np.testing.assert_array_equal(result.count, count)
    np.testing.assert_array_equal(np.asarray(result.status) == Status.CAPACITY_EXCEEDED, count > 8)
    np.testing.assert_array_equal((np.asarray(result.neighbors) >= 0).sum(axis=1), np.minimum(count, 8))
    assert (np.asarray(result.sq_dist)[np.asarray(result.neighbors) >= 0] <= np.float32(radius) ** 2).all()


@pytest.mark.parametrize(
    ("name", "radius"), [("surface", 1.0), ("surface", 40.0), ("uneven", 0.5), ("duplicates", 1.0)]
)
def test_radius_count_by_the_tree_equals_scipy(name, radius):
    xyz = CLOUDS[name](LARGE)  # 40 reaches more points than a block's leaves hold
    count = cKDTree(xyz.astype(np.float64)).query_ball_point(xyz.astype(np.float64), radius, return_length=True)
    found = np.asarray(radius_count(jnp.asarray(xyz), radius=radius, include_self=True).count)
    # A pair whose distance is the radius to float32 rounding may fall on either side.
    assert (np.abs(found - count) <= 1).all()
    assert (found != count).mean() < 0.01
    some = jnp.asarray(xyz[:200])
    np.testing.assert_array_equal(radius_count(jnp.asarray(xyz), radius=radius, queries=some).count, found[:200])
    np.testing.assert_array_equal(radius_count(jnp.asarray(xyz), radius=radius).count, found - 1)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"k": 0}, "k: expected at least 1, got 0"),
        ({"k": 3, "queries": jnp.zeros((4, 2))}, r"queries: expected shape \[q, 3\], got \[4, 2\]"),
        ({"k": 3, "mask": jnp.ones(4, dtype=bool)}, r"mask: expected shape \[9\], got \[4\]"),
    ],
)
def test_bad_arguments_are_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        knn.__wrapped__.__wrapped__(jnp.zeros((9, 3)), **kwargs)
