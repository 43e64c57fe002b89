"""Depthwise-separable convolution on the cylinder raster: closed around the cable, open along it."""

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
        # Nine shifted products: XLA's grouped convolution on the CPU takes one channel at a time.
        mixed = depthwise_conv(grid, self.depthwise[...], dilation=self.dilation)
        return jax.nn.gelu(self.norm(self.pointwise(mixed)))


def depthwise_conv(
    grid: Float[Array, "b h w c"], kernel: Float[Array, "3 3 c"], *, dilation: int = 1
) -> Float[Array, "b h w c"]:
    """3x3 convolution of each channel by itself, wrapped along w and zero-padded along h, size kept.

    Raises:
        ValueError: If the raster is narrower than the dilation.
    """
    height, width = grid.shape[1:3]
    if width < dilation:
        raise ValueError(f"grid: expected at least {dilation} cells around the cable for that dilation, got {width}")
    padded = jnp.pad(grid, ((0, 0), (dilation, dilation), (0, 0), (0, 0)))
    padded = jnp.concatenate([padded[:, :, width - dilation :], padded, padded[:, :, :dilation]], axis=2)
    total = jnp.zeros_like(grid)
    for row in range(3):
        for column in range(3):
            top, left = row * dilation, column * dilation
            total = total + padded[:, top : top + height, left : left + width] * kernel[None, None, None, row, column]
    return total
