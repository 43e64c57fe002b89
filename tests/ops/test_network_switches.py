"""The network's kernels under jax's switches, with other dtypes, as gradients and inside `shard_map`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec

from cablejax.ops import (
    AttentionWeights,
    cylinder_frame,
    cylinder_raster,
    edge_conv,
    edge_features,
    feature_graph,
    local_moments,
    neighbor_max,
    neighbor_sum,
    principal_frame,
    raster_taps,
    sample_raster,
)

N, C, D, H, K = 64, 3, 8, 4, 6
SHAPE = (4, 8)


def values(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def points():
    rng = np.random.default_rng(5)
    angle, radius = rng.uniform(0, np.pi, N), 5 + 0.1 * rng.normal(size=N)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 20, N)], axis=1).astype(np.float32)


GRAPH = np.random.default_rng(1).integers(0, N, (N, K)).astype(np.int32)


def convolved(xyz):
    weights = AttentionWeights(*(jnp.asarray(values(*s), dtype=xyz.dtype) for s in ((D, H), (H,), (H, D), (D,))))
    scale, shift = (jnp.asarray(values(D, seed=seed), dtype=xyz.dtype) for seed in (2, 3))
    kernel = jnp.asarray(values(2 * C, D), dtype=xyz.dtype)
    return edge_conv(xyz, jnp.asarray(GRAPH), kernel, scale=scale, shift=shift, attention=weights)


def rastered(xyz):
    taps = raster_taps(xyz[:, 2] - 10, jnp.arctan2(xyz[:, 1], xyz[:, 0]), shape=SHAPE, half_length=10.0)
    grid, _ = cylinder_raster(xyz, taps, shape=SHAPE)
    return sample_raster(grid, taps)


SMOOTH = {  # kernels with gradients
    "edge_conv": convolved,
    "edge_features": lambda xyz: edge_features(xyz, jnp.asarray(GRAPH)),
    "neighbor_max": lambda xyz: neighbor_max(xyz, jnp.asarray(GRAPH)),
    "neighbor_sum": lambda xyz: neighbor_sum(xyz, jnp.asarray(GRAPH)),
    "moments": lambda xyz: local_moments(xyz, jnp.asarray(GRAPH)).covariance,
    "raster": rastered,
}
KERNELS = {
    **SMOOTH,
    "graph": lambda xyz: feature_graph(xyz, k=K),
    "graph of many channels": lambda xyz: feature_graph(jnp.concatenate([xyz, xyz * xyz], axis=1), k=K),
    "cylinder_frame": lambda xyz: cylinder_frame(xyz).radius,
    "principal_frame": lambda xyz: principal_frame(xyz)[1],
}
# One program each, where the operations by themselves are some hundred.
KERNELS = {name: jax.jit(kernel) for name, kernel in KERNELS.items()}
SWITCHES = {
    "x64": lambda: jax.enable_x64(True),
    "nans": lambda: jax.debug_nans(True),
    "strict": lambda: jax.numpy_dtype_promotion("strict"),
}


def close(found, expected):
    np.testing.assert_allclose(np.asarray(found), np.asarray(expected), atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.parametrize("name", KERNELS)
def test_a_switch_changes_nothing(name, switch):
    plain = KERNELS[name](jnp.asarray(points()))
    with SWITCHES[switch]():
        switched = KERNELS[name](jnp.asarray(points()))
    assert switched.dtype == plain.dtype
    close(switched, plain)


@pytest.mark.parametrize("name", KERNELS)
def test_float64_is_computed_with_or_refused_in_a_sentence(name):
    with jax.enable_x64(True):
        try:
            found = KERNELS[name](jnp.asarray(points(), dtype=np.float64))
        except ValueError as error:
            assert "expected float32" in str(error)  # noqa: PT017
            return
    close(found, KERNELS[name](jnp.asarray(points())))


@pytest.mark.parametrize("dtype", ["float16", "bfloat16"])
@pytest.mark.parametrize("name", KERNELS)
def test_half_precision_is_computed_with_or_refused_in_a_sentence(name, dtype):
    half = jnp.asarray(points(), dtype=dtype)
    try:
        found = KERNELS[name](half)
    except ValueError as error:
        assert "expected float32" in str(error)  # noqa: PT017
        return
    if found.dtype == jnp.int32:  # a graph of points that are equally far to rounding: most edges
        agreed = np.asarray(found) == np.asarray(KERNELS[name](half.astype(jnp.float32)))
        assert agreed.mean() > 0.5
        return
    expected = np.asarray(KERNELS[name](half.astype(jnp.float32)))
    np.testing.assert_allclose(np.asarray(found, np.float32), expected, atol=0.05 * np.abs(expected).max())


@pytest.mark.parametrize("name", SMOOTH)
def test_gradients_of_points_that_coincide_are_finite(name):
    xyz = jnp.asarray(np.repeat(points()[: N // 4], 4, axis=0))
    gradient = jax.jit(jax.grad(lambda x: (SMOOTH[name](x) ** 2).sum()))(xyz)
    assert np.isfinite(np.asarray(gradient)).all()


@pytest.mark.parametrize("name", KERNELS)
def test_inside_shard_map(name):
    mesh = jax.make_mesh((1,), ("device",), axis_types=(AxisType.Auto,), devices=jax.devices()[:1])
    spec = PartitionSpec("device")

    @jax.jit
    @jax.shard_map(mesh=mesh, in_specs=spec, out_specs=spec)
    def sharded(xyz):
        return jnp.atleast_1d(KERNELS[name](xyz))

    close(sharded(jnp.asarray(points())), jnp.atleast_1d(KERNELS[name](jnp.asarray(points()))))
