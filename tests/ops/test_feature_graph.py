"""The dynamic graph against sorting all distances, by either way of choosing, and where one gives way to the other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops.feature_graph import distance_keys, feature_graph
from cablejax.ops.neighbors.dense import GROUPS
from tests.reference import edges as reference

N, K, C = 24, 5, 4
MANY, FAR = 300, 20  # enough points for the choice by threshold, and no multiple of its groups
graphs = jax.jit(jax.vmap(lambda x, m: feature_graph(x, k=FAR, mask=m)))


def sample(seed, channels):
    mask = np.ones(N, bool)
    mask[[3, 20]] = False
    return {"features": np.random.default_rng(seed).normal(size=(N, channels)), "mask": mask}


def f32(array):
    return jnp.asarray(array, jnp.float32)


@pytest.mark.parametrize("channels", [3, C])
@pytest.mark.parametrize("kind", ["random", "tied", "equal"])
def test_graph_equals_sorting_all_distances(channels, kind):
    data = sample(1, channels)
    features = data["features"]
    if kind == "tied":
        features = np.round(features)  # a lattice: exact in float32, many equal distances
    if kind == "equal":
        features = np.zeros_like(features)
    found = feature_graph(f32(features), k=K, mask=jnp.asarray(data["mask"]))
    if channels == 3 or kind == "equal":
        np.testing.assert_array_equal(found, reference.graph(np.asarray(f32(features), np.float64), K, data["mask"]))
    else:  # by a matrix product: distances agree to its rounding, equal ones may come in another order
        expected = reference.graph(features, K, data["mask"])
        for i in np.flatnonzero(data["mask"]):
            distance = ((features - features[i]) ** 2).sum(axis=1)
            np.testing.assert_allclose(distance[np.asarray(found[i])], distance[expected[i]], atol=1e-4)


def test_graph_marks_missing_neighbours():
    found = np.asarray(feature_graph(jnp.arange(4.0)[:, None], k=3, mask=jnp.array([True, False, True, False])))
    np.testing.assert_array_equal(found, [[0, 2, -1], [-1, -1, -1], [2, 0, -1], [-1, -1, -1]])


@pytest.mark.parametrize("k", [0, 4])
def test_graph_refuses_k_out_of_range(k):
    with pytest.raises(ValueError, match=f"k: expected 1 to n = 3, got {k}"):
        feature_graph(jnp.zeros((3, 3)), k=k)


def expected_graphs(features, mask):
    return np.stack([reference.graph(np.asarray(x, np.float64), FAR, m) for x, m in zip(features, mask, strict=True)])


def large_clouds():
    """Random points, and clouds that leave the usual way: a lattice of ties, two heaps of equal points, few points."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(4, MANY, 3)).astype(np.float32)
    features[1] = np.round(features[1])
    features[2] = np.where(np.arange(MANY)[:, None] < 100, 0.0, 1.0)
    mask = np.ones((4, MANY), bool)
    mask[0, 250:] = False
    mask[3, 7:] = False
    return features, mask


def test_choice_by_threshold_equals_sorting():
    features, mask = large_clouds()
    assert MANY >= 2 * GROUPS
    np.testing.assert_array_equal(graphs(jnp.asarray(features), jnp.asarray(mask)), expected_graphs(features, mask))


def test_a_row_that_is_not_finite_finds_itself_alone():
    features, mask = large_clouds()
    features[3, 100] = np.nan
    features[0, 5, 1] = np.inf
    found = np.asarray(graphs(jnp.asarray(features), jnp.asarray(mask)))
    np.testing.assert_array_equal(found[0, 5], [5] + [-1] * (FAR - 1))
    others = np.delete(np.arange(MANY), 5)[:200]
    assert (found[0, others] != 5).all()
    assert (found[0, others] >= 0).all()


def test_padding_and_order_of_clouds_change_nothing():
    features, mask = map(jnp.asarray, large_clouds())
    garbage = jnp.where(mask[..., None], features, 1e6)
    np.testing.assert_array_equal(graphs(garbage[::-1], mask[::-1]), graphs(features, mask)[::-1])


def test_one_cloud_outside_vmap_and_eagerly():
    features, mask = large_clouds()
    found = feature_graph(jnp.asarray(features[0]), k=FAR, mask=jnp.asarray(mask[0]))
    np.testing.assert_array_equal(found, expected_graphs(features[:1], mask[:1])[0])


def test_keys_are_squared_distances():
    features = f32(np.random.default_rng(1).normal(size=(N, C)))
    keys = np.array(distance_keys(features, jnp.ones(N, dtype=bool)))
    assert (np.diag(keys) == -1).all()
    np.fill_diagonal(keys, 0.0)
    distance = ((np.asarray(features)[:, None] - np.asarray(features)[None]) ** 2).sum(axis=2)
    np.testing.assert_allclose(keys, distance, atol=1e-4)
