"""Depthwise-separable convolution on the cylinder raster: closed around the cable, open along it."""

from functools import partial

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from cablejax.nets.init import he_normal
from cablejax.nets.norm import BatchNorm


class SeparableConv(nnx.Module):
    """3x3 depthwise and 1x1 pointwise convolution, batch normalisation, GELU.

    The angular axis wraps around; the axial one is padded with zeros.

    Args:
        in_features: Channels of the input.
        features: Channels of the output.
        dilation: Spacing of the 3x3 taps.
    """

    def __init__(self, in_features: int, features: int, *, dilation: int = 1, rngs: nnx.Rngs):
        self.dilation = dilation
        self.depthwise = nnx.Param(he_normal(rngs.params(), (3, 3, in_features), jnp.float32))
        self.pointwise = nnx.Linear(in_features, features, use_bias=False, kernel_init=he_normal, rngs=rngs)
        self.norm = BatchNorm(features)

    def __call__(self, grid: Float[Array, "b h w c"]) -> Float[Array, "b h w d"]:
        """Convolve a raster `[b, h, w, c]` of (axial, angular) cells."""
        mixed: Array = depthwise_conv(grid, self.depthwise[...], self.dilation)
        return jax.nn.gelu(self.norm(self.pointwise(mixed)))


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def depthwise_conv(
    grid: Float[Array, "b h w c"], kernel: Float[Array, "3 3 c"], dilation: int = 1
) -> Float[Array, "b h w c"]:
    """3x3 convolution of each channel by itself, wrapped along w and zero-padded along h, size kept.

    Nine shifted products: XLA's grouped convolution on the CPU takes one channel at a time. The gradients are the same
    products with the kernel turned round, and nine sums, one after the other, which XLA would else interleave badly.

    Raises:
        ValueError: If the raster is narrower than the dilation.
    """
    padded, total = _padded(grid, dilation), jnp.zeros_like(grid)
    for row in range(3):
        for column in range(3):
            shifted = _window(padded, row, column, dilation, grid.shape)
            total = total + shifted * kernel[None, None, None, row, column]
    return total


def _depthwise_forward(grid: Array, kernel: Array, dilation: int) -> tuple[Array, tuple[Array, Array]]:
    return depthwise_conv(grid, kernel, dilation), (grid, kernel)


def _depthwise_backward(dilation: int, residuals: tuple[Array, Array], grad: Array) -> tuple[Array, Array]:
    grid, kernel = residuals
    padded = _padded(grid, dilation)

    def tap(i: Array, total: Array) -> Array:
        shifted = _window(padded, i // 3, i % 3, dilation, grid.shape)
        # The barrier keeps the sum out of the update, which would take it again for every row.
        return total.at[i].set(jax.lax.optimization_barrier(jnp.sum(shifted * grad, axis=(0, 1, 2))))

    total = jax.lax.fori_loop(0, 9, tap, jnp.zeros((9, grid.shape[3]), grad.dtype))
    return depthwise_conv(grad, kernel[::-1, ::-1], dilation), total.reshape(kernel.shape)


depthwise_conv.defvjp(_depthwise_forward, _depthwise_backward)


def _padded(grid: Float[Array, "b h w c"], dilation: int) -> Float[Array, "b p q c"]:
    """The raster with as many cells more on every side: around the cable its own, along it zeros."""
    width = grid.shape[2]
    if width < dilation:
        raise ValueError(f"grid: expected at least {dilation} cells around the cable for that dilation, got {width}")
    padded = jnp.pad(grid, ((0, 0), (dilation, dilation), (0, 0), (0, 0)))
    padded = jnp.concatenate([padded[:, :, width - dilation :], padded, padded[:, :, :dilation]], axis=2)
    return jax.lax.optimization_barrier(padded)  # else each of nine windows computes it anew, activation included


def _window(padded: Array, row: Array | int, column: Array | int, dilation: int, shape: tuple[int, ...]) -> Array:
    """What the tap (row, column) of the kernel sees."""
    return jax.lax.dynamic_slice(padded, (0, row * dilation, column * dilation, 0), shape)
