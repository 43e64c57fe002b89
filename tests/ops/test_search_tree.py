"""A tree built once and asked often: what it answers is what `knn`, `radius_search` and `radius_count` answer."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import build_tree, knn, query, query_count, query_radius, radius_count, radius_search
from cablejax.types import PointCloud, Status

SMALL, LARGE, K = 260, 2500, 7  # as in test_neighbors: the same programs


def cloud(n: int, axes: int = 3, seed: int = 0) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).random((n, axes)), dtype=jnp.float32)


def assert_equal(found, expected) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("n", [SMALL, LARGE])
def test_a_tree_answers_as_knn_does(n):
    xyz, mask = cloud(n), jnp.arange(n) % 5 > 0
    tree = build_tree(xyz, mask=mask)
    assert (tree.tree is None) == (n == SMALL)
    assert_equal(query(tree, k=K), knn(xyz, k=K, mask=mask))


def test_one_tree_serves_many_k_radii_and_queries():
    xyz, queries = cloud(SMALL), cloud(40, seed=1)
    tree = build_tree(xyz)
    scipy = cKDTree(np.asarray(xyz, dtype=np.float64))
    for k in (1, 5, SMALL + 3):
        found = query(tree, queries, k=k)
        distance, row = scipy.query(np.asarray(queries, dtype=np.float64), min(k, SMALL))
        np.testing.assert_allclose(np.sqrt(found.sq_dist[:, :SMALL]), distance.reshape(40, -1), atol=3e-7)
        assert (np.asarray(found.neighbors[:, SMALL:]) == -1).all()
        assert (np.asarray(found.neighbors)[:, :1] == row.reshape(40, -1)[:, :1]).all()
        assert (np.asarray(found.status) == (Status.TOO_FEW_NEIGHBORS if k > SMALL else 0)).all()
    for radius in (0.1, 0.4):
        expected = radius_search(xyz, radius=radius, capacity=9, queries=queries)
        assert_equal(query_radius(tree, queries, radius=radius, capacity=9), expected)
        assert_equal(query_count(tree, queries, radius=radius), radius_count(xyz, radius=radius, queries=queries))
    own = query(tree, k=1, include_self=True)
    np.testing.assert_array_equal(own.neighbors[:, 0], np.arange(SMALL))


@pytest.mark.parametrize("axes", [1, 2, 12])
def test_trees_of_other_dimensions(axes):
    xyz = cloud(SMALL, axes)
    assert_equal(query(build_tree(xyz), k=K), knn(xyz, k=K))


def test_trees_are_made_and_asked_under_vmap_and_go_through_jit():
    clouds, queries = jnp.stack([cloud(SMALL), cloud(SMALL, seed=1)]), jnp.stack([cloud(9, seed=2), cloud(9, seed=3)])
    trees = jax.jit(jax.vmap(build_tree))(clouds)
    found = jax.jit(jax.vmap(partial(query, k=K)))(trees, queries)
    for i in range(2):
        assert_equal([part[i] for part in found], query(build_tree(clouds[i]), queries[i], k=K))


def test_a_tree_of_a_large_cloud_answers_under_vmap():
    queries = cloud(2 * 50, seed=4).reshape(2, 50, 3)
    tree = build_tree(cloud(LARGE))
    found = jax.vmap(lambda some: query(tree, some, k=K).sq_dist)(queries)
    scipy = cKDTree(np.asarray(tree.xyz, dtype=np.float64))
    distance = scipy.query(np.asarray(queries, dtype=np.float64), K)[0]
    np.testing.assert_allclose(np.sqrt(found), distance, atol=3e-7)


def test_under_x64():
    with jax.enable_x64():
        tree = build_tree(cloud(SMALL))
        found = query(tree, k=K)
        assert (found.neighbors.dtype, found.sq_dist.dtype, found.status.dtype) == (jnp.int32, jnp.float32, jnp.int32)
        assert query_count(tree, radius=0.2).count.dtype == jnp.int32
        np.testing.assert_array_equal(found.neighbors, knn(cloud(SMALL), k=K).neighbors)


def test_a_tree_of_an_empty_cloud_finds_nothing():
    tree = build_tree(cloud(SMALL), mask=jnp.zeros(SMALL, dtype=bool))
    found = query(tree, cloud(9), k=2)
    assert (np.asarray(found.neighbors) == -1).all()
    assert (np.asarray(found.status) == Status.TOO_FEW_NEIGHBORS).all()
    assert not np.asarray(query_count(tree, cloud(9), radius=9.0).count).any()


def test_gradients_go_through_the_tree_and_the_queries():
    xyz, queries = cloud(SMALL), cloud(9, seed=1)

    def by_tree(xyz, queries):
        return jnp.sum(jnp.sin(query(build_tree(xyz), queries, k=K).sq_dist))

    def directly(xyz, queries):
        near = knn(xyz, k=K, queries=queries).neighbors
        return jnp.sum(jnp.sin(jnp.square(xyz[near] - queries[:, None, :]).sum(axis=-1)))

    for one, other in zip(
        jax.grad(by_tree, (0, 1))(xyz, queries), jax.grad(directly, (0, 1))(xyz, queries), strict=True
    ):
        np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("radius", [-1.0, float("nan")])
def test_a_radius_that_is_none_finds_nothing_and_says_so(radius):
    tree = build_tree(cloud(SMALL), mask=jnp.arange(SMALL) > 0)
    found, counted = query_radius(tree, radius=radius, capacity=3), query_count(tree, radius=radius)
    assert (np.asarray(found.neighbors) == -1).all()
    for result in (found, counted):
        assert not np.asarray(result.count).any()
        np.testing.assert_array_equal(result.status, np.where(np.arange(SMALL) > 0, int(Status.INVALID), 0))


def unchecked(function):
    """Without the types that tests check, as a borrower calls it."""
    return getattr(function, "__wrapped__", function)


@pytest.mark.parametrize("ask", [partial(query, k=1), partial(query_count, radius=1.0)])
@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (cKDTree(np.zeros((5, 3))), "tree: expected what cablejax.ops.build_tree returns, got cKDTree"),
        (np.zeros((5, 3)), "tree: expected what cablejax.ops.build_tree returns, got ndarray"),
        (PointCloud.from_xyz(np.zeros((5, 3))), "tree: expected what .* got PointCloud"),
        ("batch", r"tree: expected one of points \[n, c\], got one of \[2, 5, 3\]; ask a batch by jax.vmap"),
    ],
)
def test_a_tree_of_the_wrong_kind_is_refused_in_a_sentence(ask, tree, message):
    tree = jax.vmap(build_tree)(jnp.zeros((2, 5, 3))) if isinstance(tree, str) else tree
    with pytest.raises(ValueError, match=message):
        unchecked(ask.func)(tree, **ask.keywords)


def test_a_radius_for_each_query_is_refused():
    tree = build_tree(jnp.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"radius: expected one number, got shape \[5\]"):
        unchecked(query_radius)(tree, radius=jnp.ones(5), capacity=5)
    with pytest.raises(ValueError, match=r"radius: expected one number, got shape \[5\]"):
        unchecked(query_count)(tree, radius=jnp.ones(5))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"queries": jnp.zeros((4, 2)), "k": 1}, r"queries: expected shape \[q, 3\], got \[4, 2\]"),
        ({"k": 0}, "k: expected at least 1, got 0"),
        ({"k": 1, "row_splits": jnp.array([0, 5])}, "row_splits: expected None without queries"),
        (
            {"queries": jnp.zeros((4, 3)), "k": 1, "row_splits": jnp.array([0, 4])},
            "row_splits: .* the tree is of one cloud",
        ),
    ],
)
def test_bad_questions_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        unchecked(query)(build_tree(jnp.zeros((5, 3))), **arguments)
