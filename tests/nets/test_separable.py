"""The depthwise convolution of the cylinder raster against XLA's own grouped convolution, values and gradients."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.nets import separable
from cablejax.nets.separable import depthwise_conv

RNG = np.random.default_rng(0)
GRID, KERNEL, BACK = (
    jnp.asarray(RNG.normal(size=shape), jnp.float32) for shape in ((2, 4, 6, 5), (3, 3, 5), (2, 4, 6, 5))
)


def grouped(grid: jax.Array, kernel: jax.Array, dilation: int) -> jax.Array:
    """Wrapped along w, zero-padded along h."""
    wrapped = jnp.concatenate([grid[:, :, -dilation:], grid, grid[:, :, :dilation]], axis=2)
    return jax.lax.conv_general_dilated(
        wrapped, kernel[:, :, None], (1, 1), ((dilation, dilation), (0, 0)), rhs_dilation=(dilation, dilation),
        dimension_numbers=("NHWC", "HWIO", "NHWC"), feature_group_count=grid.shape[3],
    )  # fmt: skip


@pytest.mark.parametrize("dilation", [1, 3])
@pytest.mark.parametrize("gradients", ["_gradients_by_cloud", "_gradients_together"])
def test_values_and_gradients(dilation: int, gradients: str):
    value, pull = jax.vjp(partial(grouped, dilation=dilation), GRID, KERNEL)
    # Sums of at most 48 products of numbers of size one: float32 is off by some 48 * 2**-24 = 3e-6.
    close = partial(np.testing.assert_allclose, rtol=0, atol=2e-5)
    close(depthwise_conv(GRID, KERNEL, dilation), value)
    padded = separable._padded(GRID, dilation)
    for ours, theirs in zip(
        getattr(separable, gradients)(dilation, padded, KERNEL, BACK),
        pull(BACK), strict=True,
    ):  # fmt: skip
        close(ours, theirs)
    own = jax.vjp(lambda g, k: depthwise_conv(g, k, dilation), GRID, KERNEL)[1](BACK)
    for ours, theirs in zip(own, pull(BACK), strict=True):
        close(ours, theirs)
