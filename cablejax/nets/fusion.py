"""Feature fusion, section III.A.3."""

from collections.abc import Sequence

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from cablejax.nets.init import lecun_normal
from cablejax.nets.separable import SeparableConv

DILATIONS = (2, 3, 4)


class FusionBranch(nnx.Module):
    """Two 3x3 depthwise-separable convolutions, then a dilated one around which a skip goes.

    Args:
        in_features: Channels of the concatenated maps.
        features: Channels of the branch.
        dilation: Rate of the third convolution.
    """

    def __init__(self, in_features: int, features: int, *, dilation: int, rngs: nnx.Rngs):
        self.first = SeparableConv(in_features, features, rngs=rngs)
        self.second = SeparableConv(features, features, rngs=rngs)
        self.dilated = SeparableConv(features, features, dilation=dilation, rngs=rngs)

    def __call__(self, grid: Float[Array, "b h w c"]) -> Float[Array, "b h w d"]:
        """Widen the receptive field of a raster `[b, h, w, c]`."""
        x = self.second(self.first(grid))
        return x + self.dilated(x)


class FeatureFusion(nnx.Module):
    """Concatenate maps, pass them through three parallel branches (rates 2, 3, 4), add, and mix by a 1x1 convolution.

    Args:
        in_features: Channels of all maps together.
        width: Channels of a branch.
        features: Channels of the result.
    """

    def __init__(self, in_features: int, features: int, *, width: int, rngs: nnx.Rngs):
        self.branches = nnx.List([FusionBranch(in_features, width, dilation=rate, rngs=rngs) for rate in DILATIONS])
        self.mix = nnx.Linear(width, features, kernel_init=lecun_normal, rngs=rngs)

    def __call__(self, grids: Sequence[Float[Array, "b h w c"]]) -> Float[Array, "b h w d"]:
        """Fuse maps of the same raster."""
        joined = jnp.concatenate(list(grids), axis=-1)
        total = self.branches[0](joined)
        for branch in self.branches[1:]:
            total = total + branch(joined)
        return self.mix(total)
