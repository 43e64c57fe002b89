"""Search in a periodic box against SciPy's, whose tree knows boxes that close along every axis."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import build_tree, knn, query, query_count, radius_count, radius_search
from cablejax.types import Status

K = 7
BOX = np.array([3.0, 0.5, 8.0])


def cloud(n: int, axes: int = 3) -> np.ndarray:
    return (np.random.default_rng(5).random((n, axes)) * BOX[:axes]).astype(np.float32)


def by_scipy(xyz: np.ndarray, box: np.ndarray) -> cKDTree:
    return cKDTree(xyz.astype(np.float64) % box, boxsize=box)


@pytest.mark.parametrize(("n", "axes"), [(260, 1), (260, 2), (260, 3), (2500, 3)])
def test_neighbours_in_a_box_are_those_of_scipy(n, axes):
    xyz, box = cloud(n, axes), BOX[:axes]
    tree = build_tree(jnp.asarray(xyz), box=jnp.asarray(box, dtype=jnp.float32))
    scipy = by_scipy(xyz, box)
    exact = scipy.query(scipy.data, K + 1)[0][:, 1:]
    # Coordinates below 8: a difference is right to 5e-7.
    np.testing.assert_allclose(np.sqrt(query(tree, k=K).sq_dist), exact, atol=2e-6)
    radius = 0.3
    low, high = (scipy.query_ball_point(scipy.data, r, return_length=True) for r in (radius - 2e-6, radius + 2e-6))
    count = np.asarray(query_count(tree, radius=radius, include_self=True).count)
    assert ((low <= count) & (count <= high)).all()


def test_it_does_not_matter_in_which_image_a_point_was_given():
    xyz, box = cloud(260), jnp.asarray(BOX, dtype=jnp.float32)
    images = np.random.default_rng(6).integers(-3, 4, size=xyz.shape) * BOX
    plain, moved = (knn(jnp.asarray(each, dtype=jnp.float32), k=K, box=box).sq_dist for each in (xyz, xyz + images))
    # Three boxes away coordinates are right to 2e-6.
    np.testing.assert_allclose(np.sqrt(plain), np.sqrt(moved), atol=1e-5)


def test_an_axis_of_infinite_length_does_not_close():
    xyz = np.array([[0.1, 0.1], [2.9, 0.1], [0.1, 7.9], [-0.3, -50.0]], dtype=np.float32)
    found = knn(jnp.asarray(xyz), k=1, box=jnp.array([3.0, jnp.inf]))
    assert np.asarray(found.neighbors)[:, 0].tolist() == [1, 0, 0, 1]
    np.testing.assert_allclose(np.sqrt(np.asarray(found.sq_dist)[:3, 0]), [0.2, 0.2, 7.8], atol=2e-6)


def test_neighbours_are_found_once_however_small_the_box():
    found = radius_search(jnp.zeros((3, 3)), radius=100.0, capacity=8, box=jnp.ones(3))
    assert np.asarray(found.count).tolist() == [2, 2, 2]
    assert int(radius_count(jnp.zeros((3, 3)), radius=100.0, box=jnp.ones(3), include_self=True).count[0]) == 3


@pytest.mark.parametrize("length", [0.0, -1.0, float("nan")])
def test_a_box_that_is_none_finds_nothing_and_says_so(length):
    found = knn(jnp.asarray(cloud(260)), k=2, box=jnp.array([1.0, 1.0, length]))
    assert (np.asarray(found.neighbors) == -1).all()
    assert (np.asarray(found.status) == Status.INVALID).all()


def test_gradients_point_to_the_nearest_image():
    xyz, box = jnp.asarray(cloud(60)), jnp.asarray(BOX, dtype=jnp.float32)

    def cost(xyz):
        return jnp.sum(jnp.sin(knn(xyz, k=3, box=box).sq_dist))

    def directly(xyz):
        near = knn(jax.lax.stop_gradient(xyz), k=3, box=box).neighbors
        difference = xyz[:, None, :] - xyz[near]
        difference = difference - jax.lax.stop_gradient(jnp.round(difference / BOX[None, None, :])) * BOX[None, None, :]
        return jnp.sum(jnp.sin(jnp.square(difference).sum(axis=-1)))

    np.testing.assert_allclose(jax.grad(cost)(xyz), jax.grad(directly)(xyz), atol=1e-4)


def test_padding_under_vmap_and_x64():
    xyz, mask = jnp.asarray(cloud(60)), jnp.arange(60) % 3 > 0
    box = jnp.asarray(BOX, dtype=jnp.float32)
    with jax.enable_x64():
        both = jax.vmap(lambda box: knn(xyz, k=3, mask=mask, box=box))(jnp.stack([box, 2 * box]))
    alone = knn(xyz[mask], k=3, box=box)
    np.testing.assert_array_equal(both.sq_dist[0][mask], alone.sq_dist)
    assert (np.asarray(both.neighbors)[0][~np.asarray(mask)] == -1).all()


def test_a_box_of_the_wrong_shape_is_named():
    with pytest.raises(ValueError, match=r"box: expected one length per axis, shape \[3\], got \[2\]"):
        knn.__wrapped__.__wrapped__(jnp.zeros((9, 3)), k=1, box=jnp.ones(2))
