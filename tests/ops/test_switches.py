"""Under jax's switches, with other dtypes and inside `shard_map`, kernels give the same or say why not."""

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec

from cablejax.ops import (
    adaptive_filter,
    clean,
    kabsch,
    knn,
    median_outliers,
    radius_outliers,
    se3_exp,
    statistical_outliers,
)
from cablejax.types import PointCloud

N = 120

KERNELS = {
    "order 0": lambda cloud: adaptive_filter(cloud, k=8, gamma=0.1).xyz,
    "order 2": lambda cloud: adaptive_filter(cloud, k=12, order=2).xyz,
    "clean": lambda cloud: clean(cloud, removal_k=6, k=8, order=1).xyz,
    "statistical": lambda cloud: statistical_outliers(cloud, k=6).score,
    "median": lambda cloud: median_outliers(cloud, k=6).score,
    "radius": lambda cloud: radius_outliers(cloud, radius=1.0, min_neighbors=3).score,
}
FOUND = {  # on neighbours found before
    "order 0": lambda cloud, found: adaptive_filter(cloud, found=found, gamma=0.1).xyz,
    "order 2": lambda cloud, found: adaptive_filter(cloud, found=found, order=2).xyz,
    "statistical": lambda cloud, found: statistical_outliers(cloud, k=6, found=found).score,
}
SWITCHES = {
    "x64": lambda: jax.enable_x64(True),
    "nans": lambda: jax.debug_nans(True),
    "strict": lambda: jax.numpy_dtype_promotion("strict"),
}


def points():
    rng = np.random.default_rng(5)
    angle, radius = rng.uniform(0, np.pi, N), 5 + 0.1 * rng.normal(size=N)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 6, N)], axis=1).astype(np.float32)


def cloud(xyz=None):
    return PointCloud(jnp.asarray(points() if xyz is None else xyz), jnp.arange(N) < N - 5)


@pytest.mark.parametrize("switch", ["x64", "nans"])
@pytest.mark.parametrize("name", KERNELS)
def test_a_switch_changes_nothing(name, switch):
    plain = KERNELS[name](cloud())
    with SWITCHES[switch]():
        switched = KERNELS[name](cloud())
    assert switched.dtype == jnp.float32
    np.testing.assert_allclose(switched, plain, atol=1e-3)


@pytest.mark.parametrize("name", FOUND)
def test_strict_promotion_changes_nothing(name):
    found = knn(cloud().xyz, k=8, mask=cloud().mask)
    plain = FOUND[name](cloud(), found)
    with SWITCHES["strict"]():
        np.testing.assert_allclose(FOUND[name](cloud(), found), plain, atol=1e-3)


@pytest.mark.parametrize("dtype", ["float16", "bfloat16", "int32", "float64"])
@pytest.mark.parametrize("name", KERNELS)
def test_other_dtypes_are_refused_in_a_sentence(name, dtype):
    with jax.enable_x64(True) if dtype == "float64" else contextlib.nullcontext():
        given = PointCloud(jnp.asarray(points(), dtype=dtype), jnp.ones(N, dtype=bool))
        with pytest.raises(ValueError, match=f"cloud.xyz: expected float32, got {dtype}"):
            KERNELS[name](given)


@pytest.mark.parametrize("name", FOUND)
def test_inside_shard_map(name):
    mesh = jax.make_mesh((1,), ("device",), axis_types=(AxisType.Auto,), devices=jax.devices()[:1])
    spec = PartitionSpec("device")
    found = knn(cloud().xyz, k=8, mask=cloud().mask)

    @jax.jit
    @jax.shard_map(mesh=mesh, in_specs=spec, out_specs=spec)
    def sharded(xyz, mask, found):
        return FOUND[name](PointCloud(xyz, mask), found)

    np.testing.assert_allclose(sharded(*cloud(), found), FOUND[name](cloud(), found), atol=1e-3)


@pytest.mark.parametrize("switch", SWITCHES)
def test_rigid_motions_under_a_switch(switch):
    twist = np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3], dtype=np.float32)
    plain = se3_exp(jnp.asarray(twist))
    with SWITCHES[switch]():
        moved = points() @ np.asarray(plain)[:3, :3].T + np.asarray(plain)[:3, 3]
        np.testing.assert_allclose(kabsch(jnp.asarray(points()), jnp.asarray(moved)), plain, atol=1e-4)


def test_a_default_passed_explicitly_is_the_same_program():
    def text(**given):
        return str(jax.make_jaxpr(lambda c: adaptive_filter(c, k=8, order=2, **given))(cloud()))

    assert text() == text(gamma=0.0) == text(gamma=None, crowding=0.0, beta=0.0, tau=None, alpha=None)
    assert text(gamma=0.1) != text()
