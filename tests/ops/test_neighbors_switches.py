"""The search on lines and planes, under jax's switches, inside `shard_map`, and how large a program it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import knn, radius_count, radius_search

N, K = 2500, 7  # as in test_neighbors: the same programs


def cloud(axes: int = 3) -> np.ndarray:
    return np.random.default_rng(3).random((N, axes)).astype(np.float32)


def expected(xyz: np.ndarray) -> np.ndarray:
    return cKDTree(xyz.astype(np.float64)).query(xyz.astype(np.float64), K + 1)[0][:, 1:]


def assert_exact(found: jax.Array, xyz: np.ndarray) -> None:
    # Coordinates below 1: a difference is exact to 6e-8, a distance to twice that.
    np.testing.assert_allclose(np.sqrt(np.asarray(found)), expected(xyz), atol=3e-7)


@pytest.mark.parametrize("axes", [1, 2])
def test_points_on_a_line_and_in_a_plane_go_to_the_tree(axes):
    xyz = cloud(axes)
    assert_exact(knn(jnp.asarray(xyz), k=K).sq_dist, xyz)
    in_space = np.pad(xyz, ((0, 0), (0, 3 - axes)))
    np.testing.assert_array_equal(knn(jnp.asarray(xyz), k=K).neighbors, knn(jnp.asarray(in_space), k=K).neighbors)


def test_float32_under_x64():
    xyz = cloud()
    with jax.enable_x64():
        found = knn(jnp.asarray(xyz), k=K)
        assert (found.neighbors.dtype, found.sq_dist.dtype, found.status.dtype) == (jnp.int32, jnp.float32, jnp.int32)
        assert_exact(found.sq_dist, xyz)
        within = radius_search(jnp.asarray(xyz), radius=0.05, capacity=K)
        assert within.count.dtype == jnp.int32
    assert (np.asarray(within.count) == np.asarray(radius_count(jnp.asarray(xyz), radius=0.05).count)).all()


def test_coordinates_that_would_lose_digits_are_refused():
    with jax.enable_x64(), pytest.raises(ValueError, match=r"xyz: expected float32 .*, got float64"):
        knn(jnp.asarray(cloud(), dtype=np.float64), k=K)


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_half_precision_is_computed_with_exactly(dtype):
    xyz = jnp.asarray(cloud(), dtype=dtype)
    as_it_is, widened = knn(xyz, k=K), knn(xyz.astype(jnp.float32), k=K)
    np.testing.assert_array_equal(as_it_is.neighbors, widened.neighbors)
    np.testing.assert_array_equal(as_it_is.sq_dist, widened.sq_dist)


def test_under_strict_promotion_and_nan_checks():
    xyz = cloud()
    with jax.numpy_dtype_promotion("strict"), jax.debug_nans(True):
        assert_exact(knn(jnp.asarray(xyz), k=K).sq_dist, xyz)
        assert int(radius_count(jnp.asarray(xyz), radius=0.05).status.max()) == 0


def test_inside_shard_map():
    xyz = cloud()
    mesh = jax.make_mesh((1,), ("x",), axis_types=(jax.sharding.AxisType.Auto,))
    spec = jax.sharding.PartitionSpec
    search = jax.shard_map(
        lambda xyz, queries: knn(xyz, k=K + 1, queries=queries).sq_dist,
        mesh=mesh,
        in_specs=(spec(), spec("x")),
        out_specs=spec("x"),
    )
    found = jax.jit(search)(jnp.asarray(xyz), jnp.asarray(xyz))
    assert_exact(found[:, 1:], xyz)


def test_a_batch_is_searched_cloud_by_cloud():
    both = jnp.stack([jnp.asarray(cloud()), jnp.asarray(cloud()[::-1].copy())])
    found = jax.vmap(lambda xyz: knn(xyz, k=K).sq_dist)(both)
    np.testing.assert_array_equal(found[0], found[1][::-1])


def test_a_batch_is_searched_by_a_loop():
    """Batched, a search would compute both branches of every condition, and all clouds as many rounds as the slowest."""
    one = jax.ShapeDtypeStruct((N, 3), jnp.float32)
    many = jax.ShapeDtypeStruct((4, N, 3), jnp.float32)
    for search in (lambda xyz: knn(xyz, k=K), lambda xyz: radius_search(xyz, radius=0.1, capacity=K)):
        programs = (
            (search, one),
            (jax.vmap(search), many),
            (jax.vmap(jax.vmap(search)), many.update(shape=(2, 2, N, 3))),
        )
        conditions = [jax.jit(f).lower(shape).as_text().count("stablehlo.case") for f, shape in programs]
        assert conditions == conditions[:1] * 3
        assert conditions[0] > 0


def test_the_program_stays_small():
    """What everyone compiles before the first result: lines of StableHLO, the same on every machine with one jax."""
    points = jax.ShapeDtypeStruct((53_135, 3), jnp.float32)
    lines = jax.jit(lambda xyz: knn(xyz, k=20)).lower(points).as_text().count("\n")
    assert lines < 5_000  # 4,860; 16,551 before the search became one loop
