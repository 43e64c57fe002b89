"""Neighbour graphs as edge lists: the same edges as the padded form, in a list of fixed length."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import build_tree, edge_list, knn, knn_graph, query, radius_graph
from cablejax.types import Status

N, K = 90, 4


def cloud(axes: int = 3) -> np.ndarray:
    """Whole numbers, so that many points are equally far and some lie in one place."""
    return np.random.default_rng(2).integers(0, 5, size=(N, axes)).astype(np.float32)


def edges_of(graph) -> list[tuple[int, int]]:
    count = min(int(graph.count), len(graph.senders))
    for field, none in ((graph.senders, -1), (graph.receivers, -1), (graph.sq_dist, np.inf)):
        assert (np.asarray(field)[count:] == none).all()
    return list(
        zip(np.asarray(graph.senders)[:count].tolist(), np.asarray(graph.receivers)[:count].tolist(), strict=True)
    )


def test_a_knn_graph_is_knn_as_a_list():
    mask = np.arange(N) % 7 > 0
    found = knn(jnp.asarray(cloud()), k=K, mask=jnp.asarray(mask))
    graph = knn_graph(jnp.asarray(cloud()), k=K, mask=jnp.asarray(mask))
    assert edges_of(graph) == [(int(j), i) for i in range(N) for j in found.neighbors[i] if j >= 0]
    assert (int(graph.count), int(graph.most), int(graph.status)) == (K * mask.sum(), K, 0)
    points = cloud().astype(np.float64)
    there = np.asarray(graph.senders) >= 0
    exact = np.square(points[np.asarray(graph.senders)] - points[np.asarray(graph.receivers)]).sum(axis=1)
    np.testing.assert_array_equal(np.asarray(graph.sq_dist)[there], exact[there])


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_radius_graph_has_the_pairs_of_scipy(axes):
    xyz = cloud(axes)
    pairs = cKDTree(xyz.astype(np.float64)).query_pairs(1.5, output_type="ndarray")
    most = np.bincount(pairs.ravel(), minlength=N).max()
    graph = radius_graph(jnp.asarray(xyz), radius=1.5, max_neighbors=int(most), capacity=2 * len(pairs))
    assert sorted(edges_of(graph)) == sorted([*map(tuple, pairs.tolist()), *map(tuple, pairs[:, ::-1].tolist())])
    assert (int(graph.count), int(graph.most), int(graph.status)) == (2 * len(pairs), most, 0)


@pytest.mark.parametrize(("short", "by"), [("max_neighbors", 1), ("capacity", 1)])
def test_what_finds_no_room_is_said_and_how_much_there_is(short, by):
    xyz = jnp.asarray(cloud())
    enough = radius_graph(xyz, radius=1.5, max_neighbors=60)
    sizes = {"max_neighbors": int(enough.most), "capacity": int(enough.count)}
    whole = radius_graph(xyz, radius=1.5, **sizes)
    assert int(whole.status) == 0
    assert edges_of(whole) == edges_of(enough)
    less = radius_graph(xyz, radius=1.5, **{**sizes, short: sizes[short] - by})
    assert int(less.status) == Status.CAPACITY_EXCEEDED
    assert (int(less.count) if short == "capacity" else int(less.most)) == sizes[short]
    assert set(edges_of(less)) < set(edges_of(whole))


def test_messages_are_summed_as_a_dense_adjacency_sums_them():
    xyz = jnp.asarray(cloud())
    graph = radius_graph(xyz, radius=1.5, max_neighbors=60)
    dense = np.zeros((N, N))
    dense[tuple(np.array(edges_of(graph)).T[::-1])] = 1
    features = np.random.default_rng(0).normal(size=(N, 2)).astype(np.float32)
    # Edges that are none have receiver -1, which `segment_sum` drops.
    sums = jax.ops.segment_sum(jnp.asarray(features)[graph.senders], graph.receivers, num_segments=N)
    np.testing.assert_allclose(sums, dense @ features, atol=1e-4)


def test_graphs_of_ragged_batches_trees_and_queries():
    xyz, splits = jnp.asarray(cloud()), jnp.array([0, 40, 40, N])
    graph = knn_graph(xyz, k=K, row_splits=splits)
    assert all((sender < 40) == (receiver < 40) for sender, receiver in edges_of(graph))
    by_tree = edge_list(query(build_tree(xyz, row_splits=splits), k=K), capacity=N * K)
    assert edges_of(by_tree) == edges_of(graph)
    between = radius_graph(xyz, radius=0.5, max_neighbors=30, queries=xyz[:3], include_self=True)
    assert {receiver for _, receiver in edges_of(between)} == {0, 1, 2}


def test_an_empty_cloud_has_no_edges():
    graph = knn_graph(jnp.zeros((5, 3)), k=2, mask=jnp.zeros(5, dtype=bool))
    assert (edges_of(graph), int(graph.count), int(graph.most)) == ([], 0, 0)


def test_status_of_the_points_is_that_of_the_list():
    xyz = jnp.asarray(cloud()).at[3].set(jnp.nan)
    assert int(knn_graph(xyz, k=N).status) == Status.NOT_FINITE | Status.TOO_FEW_NEIGHBORS


def test_under_vmap_and_x64():
    xyz = jnp.asarray(np.stack([cloud(), cloud()[::-1]]))
    with jax.enable_x64():
        both = jax.vmap(lambda xyz: radius_graph(xyz, radius=1.5, max_neighbors=60))(xyz)
        assert both.senders.dtype == both.count.dtype == both.status.dtype == jnp.int32
    assert edges_of([type(both)(*(field[0] for field in both))][0]) == edges_of(
        radius_graph(xyz[0], radius=1.5, max_neighbors=60)
    )


def test_distances_of_edges_have_gradients():
    xyz = jnp.asarray(np.random.default_rng(1).random((20, 3)), dtype=jnp.float32)
    gradient = jax.grad(lambda x: jnp.sum(knn_graph(x, k=2).sq_dist))(xyz)
    direct = jax.grad(lambda x: jnp.sum(knn(x, k=2).sq_dist))(xyz)
    np.testing.assert_allclose(gradient, direct, atol=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda x: knn_graph(x, k=1, capacity=0), "capacity: expected at least 1, got 0"),
        (lambda x: radius_graph(x, radius=1.0, max_neighbors=0), "max_neighbors: expected at least 1, got 0"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make(jnp.zeros((5, 3)))
