"""Depthwise-separable convolution on the cylinder raster: closed around the cable, open along it."""

from functools import partial

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from cablejax.nets.init import he_normal
from cablejax.nets.norm import BatchNorm
from cablejax.ops.product import row_product


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
        rows = row_product(mixed.reshape(-1, mixed.shape[-1]), self.pointwise.kernel[...])
        return jax.nn.gelu(self.norm(rows.reshape(*mixed.shape[:-1], -1)))


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def depthwise_conv(
    grid: Float[Array, "b h w c"], kernel: Float[Array, "3 3 c"], dilation: int = 1
) -> Float[Array, "b h w c"]:
    """3x3 convolution of each channel by itself, wrapped along w and zero-padded along h, size kept.

    Nine shifted products: XLA's grouped convolution on the CPU takes one channel at a time. The gradients are the same
    products with the kernel turned round, and nine sums.

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
    arrays = _padded(grid, dilation), kernel, grad
    by_cloud, together = partial(_gradients_by_cloud, dilation), partial(_gradients_together, dilation)
    return jax.lax.platform_dependent(*arrays, cpu=by_cloud, default=together)


def _gradients_together(dilation: int, padded: Array, kernel: Array, grad: Array) -> tuple[Array, Array]:
    """Gradients with respect to the raster and the kernel."""
    taps = [jnp.sum(_window(padded, i // 3, i % 3, dilation, grad.shape) * grad, axis=(0, 1, 2)) for i in range(9)]
    return depthwise_conv(grad, kernel[::-1, ::-1], dilation), jnp.stack(taps).reshape(kernel.shape)


def _gradients_by_cloud(dilation: int, padded: Array, kernel: Array, grad: Array) -> tuple[Array, Array]:
    """The same in a loop over the clouds, whose body is a fence.

    XLA on the CPU would work the incoming gradient out anew for each of the nine sums, and sums over rows one channel at a
    time; here whole rasters are added. Of the network's training step at 24 clouds this took 421 ms to 316 ms.
    """

    def add(totals: list[Array], cloud: tuple[Array, Array]) -> tuple[list[Array], Array]:
        rows, back = (each[None] for each in cloud)
        windows = [_window(rows, i // 3, i % 3, dilation, back.shape) for i in range(9)]
        totals = [total + (window * back)[0] for total, window in zip(totals, windows, strict=True)]
        moved: Array = depthwise_conv(back, kernel[::-1, ::-1], dilation)
        return totals, moved[0]

    totals, moved = jax.lax.scan(add, [jnp.zeros(grad.shape[1:], grad.dtype)] * 9, (padded, grad))
    taps = [jnp.sum(each, axis=(0, 1)) for each in totals]
    return moved, jnp.stack(taps).reshape(kernel.shape)


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
