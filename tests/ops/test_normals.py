"""Normals against NumPy's principal components and Open3D's, and their signs along surfaces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import estimate_normals, knn, orient_normals
from cablejax.types import Status
from tests.reference import neighbors as reference

N, K = 240, 10


def sphere(n: int = N, seed: int = 0) -> np.ndarray:
    """Points on a sphere of radius 1, evenly enough for neighbourhoods to be small."""
    step = np.arange(n) + 0.5
    height, angle = 1 - 2 * step / n, np.pi * (1 + 5**0.5) * step + seed
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1).astype(np.float32)


def normals_by_lapack(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    near = reference.knn(xyz, K + 1, include_self=True)[0]
    around = xyz.astype(np.float64)[near]
    spread = around - around.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    return vectors[:, :, 0], values[:, 0] / values.sum(axis=1)


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_normals_are_the_least_principal_components(offset):
    xyz = (sphere() + np.random.default_rng(0).normal(size=(N, 3)) * 0.02 + offset).astype(np.float32)
    found = estimate_normals(jnp.asarray(xyz), k=K)
    normals, variation = normals_by_lapack(xyz)
    np.testing.assert_allclose(np.abs(np.sum(np.asarray(found.normals) * normals, axis=1)), 1.0, atol=1e-5)
    np.testing.assert_allclose(found.variation, variation, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-6)
    assert not np.asarray(found.status).any()


def test_as_open3d(open3d_cloud):
    import open3d

    cloud = open3d_cloud(sphere())
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(K + 1))
    found = estimate_normals(jnp.asarray(sphere()), k=K)
    # On an even grid neighbours are equally far, and the last of them may be another.
    np.testing.assert_allclose(
        np.abs(np.sum(np.asarray(found.normals) * np.asarray(cloud.normals), axis=1)), 1, atol=1e-2
    )


def test_they_point_to_the_viewpoint_and_to_the_side_it_is_on():
    xyz = sphere()
    inside = estimate_normals(jnp.asarray(xyz), k=K, viewpoint=jnp.zeros(3)).normals
    assert (np.sum(np.asarray(inside) * xyz, axis=1) < 0).all()
    above = estimate_normals(jnp.asarray(xyz), k=K, viewpoint=jnp.array([0.0, 0.0, 100.0])).normals
    assert (np.asarray(above)[np.abs(xyz[:, 2]) > 0.2, 2] > 0).all()


def test_a_radius_and_neighbours_found_elsewhere():
    xyz = jnp.asarray(sphere())
    found = knn(xyz, k=K)
    np.testing.assert_array_equal(estimate_normals(xyz, found=found).normals, estimate_normals(xyz, k=K).normals)
    near = estimate_normals(xyz, k=40, radius=0.4)
    assert not np.asarray(near.status).any()
    assert (np.abs(np.sum(np.asarray(near.normals) * np.asarray(xyz), axis=1)) > 0.99).all()
    assert (np.asarray(estimate_normals(xyz, k=3, radius=0.4).status) == Status.CAPACITY_EXCEEDED).all()
    assert (np.asarray(estimate_normals(xyz, k=3, radius=1e-3).status) == Status.TOO_FEW_NEIGHBORS).all()


@pytest.mark.parametrize("kind", ["line", "one place"])
def test_what_determines_no_plane_has_no_normal(kind):
    xyz = np.outer(np.arange(30.0), [1.0, 2.0, -1.0]) if kind == "line" else np.full((30, 3), 7.0)
    found = estimate_normals(jnp.asarray(xyz, dtype=jnp.float32), k=K)
    assert not np.asarray(found.normals).any()
    assert (np.asarray(found.status) == Status.DEGENERATE).all()


def test_padding_and_too_few_points():
    xyz, mask = sphere(), np.arange(N) % 5 > 0
    xyz[1] = np.nan
    found = estimate_normals(jnp.asarray(xyz), k=K, mask=jnp.asarray(mask))
    good = mask & (np.arange(N) != 1)
    alone = estimate_normals(jnp.asarray(np.where(good[:, None], xyz, 0)), k=K, mask=jnp.asarray(good))
    np.testing.assert_array_equal(found.normals, alone.normals)
    assert not np.asarray(found.normals)[~good].any()
    assert int(found.status[1]) == Status.NOT_FINITE
    two = estimate_normals(jnp.asarray(sphere()[:2]), k=2)
    assert (np.asarray(two.status) == Status.TOO_FEW_NEIGHBORS).all()
    none = estimate_normals(jnp.asarray(sphere()[:5]), k=2, mask=jnp.zeros(5, dtype=bool))
    assert not np.asarray(none.status).any()


def test_under_vmap_and_x64_with_gradients():
    both = jnp.asarray(np.stack([sphere(60), sphere(60, seed=1)]))
    with jax.enable_x64():
        found = jax.vmap(lambda xyz: estimate_normals(xyz, k=K, viewpoint=jnp.zeros(3, jnp.float32)))(both)
        assert (found.normals.dtype, found.status.dtype) == (jnp.float32, jnp.int32)
    cosine = np.sum(np.asarray(found.normals) * np.asarray(both), axis=-1)
    np.testing.assert_allclose(cosine, -1, atol=0.05)

    def tilt(x):
        return jnp.sum(estimate_normals(x, k=K, viewpoint=jnp.zeros(3)).normals[:, 0])

    step = jnp.zeros_like(both[0]).at[7, 2].set(1e-3)
    change = (tilt(both[0] + step) - tilt(both[0] - step)) / 2e-3
    np.testing.assert_allclose(jax.grad(tilt)(both[0])[7, 2], change, atol=2e-2)
    line = jnp.outer(jnp.arange(20.0), jnp.array([1.0, 2.0, -1.0]))
    assert np.isfinite(np.asarray(jax.grad(tilt)(line))).all()


SURFACES = {
    "sphere": sphere(),
    "two spheres": np.concatenate([sphere(120), sphere(120, seed=1) + np.float32(10)]),
}


@pytest.mark.parametrize("name", SURFACES)
def test_signs_agree_along_each_piece(name):
    xyz, rng = SURFACES[name], np.random.default_rng(3)
    pieces = np.arange(N) // (N // 2) if name == "two spheres" else np.zeros(N, dtype=int)
    found = knn(jnp.asarray(xyz), k=6)
    normals = np.asarray(estimate_normals(jnp.asarray(xyz), found=found).normals)
    shuffled = normals * rng.choice([-1, 1], size=(N, 1)).astype(np.float32)
    oriented = np.asarray(orient_normals(jnp.asarray(xyz), jnp.asarray(shuffled), found.neighbors))
    for piece in range(pieces.max() + 1):
        own = pieces == piece
        outwards = np.sum(oriented[own] * (xyz[own] - xyz[own].mean(axis=0)), axis=1)
        assert (outwards > 0).all()  # the highest point's normal is up, and so all point outwards
    np.testing.assert_allclose(np.abs(np.sum(oriented * normals, axis=1)), 1.0, atol=1e-6)


def test_signs_go_around_a_sharp_edge_by_the_most_parallel_normals():
    """Two planks that meet at a right angle: the tree's edges within each are as good as none, the one across is the worst."""
    flat = np.stack(np.meshgrid(np.arange(12.0), np.arange(10.0), indexing="ij"), axis=-1).reshape(-1, 2)
    floor = np.concatenate([flat, np.zeros((120, 1))], axis=1)
    wall = np.concatenate([np.full((120, 1), -0.7), flat[:, 1:], flat[:, :1] + 0.7], axis=1)
    xyz = jnp.asarray(np.concatenate([floor, wall]), dtype=jnp.float32)
    normals = np.repeat(np.array([[0.1, 0.0, 1.0], [1.0, 0.0, 0.1]]), 120, axis=0) / np.sqrt(1.01)
    signs = np.random.default_rng(5).choice([-1, 1], size=(N, 1))
    oriented = orient_normals(xyz, jnp.asarray(normals * signs, dtype=jnp.float32), knn(xyz, k=6).neighbors)
    np.testing.assert_allclose(oriented, normals, atol=1e-6)


def test_points_without_normal_hand_nothing_on():
    xyz = jnp.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    normals = jnp.array([[0, 0, -1.0], [0, 0, 0], [0, 0, -1.0], [0, 0, 1.0]])
    neighbors = jnp.array([[1], [0], [3], [-1]])
    oriented = orient_normals(xyz, normals, neighbors)
    assert oriented.tolist() == [[0, 0, 1], [0, 0, 0], [0, 0, 1], [0, 0, 1]]
    assert jax.vmap(orient_normals)(xyz[None], normals[None], neighbors[None])[0].tolist() == oriented.tolist()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda x: estimate_normals(x, k=1), "k: expected at least 2, to span a plane with the point itself, got 1"),
        (
            lambda x: estimate_normals.__wrapped__.__wrapped__(x, k=2, viewpoint=jnp.zeros(2)),
            r"viewpoint: expected shape \[3\], got \[2\]",
        ),
        (lambda x: estimate_normals(x, found=knn(x[:3], k=1)), "found: expected 5 rows, got 3"),
        (lambda x: estimate_normals(x.astype(jnp.float16)), "xyz: expected float32, got float16"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make(jnp.zeros((5, 3)))
