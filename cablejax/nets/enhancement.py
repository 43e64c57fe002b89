"""Feature enhancement, section III.A.2 and Figure 4."""

from flax import nnx
from jaxtyping import Array, Float

from cablejax.nets.separable import SeparableConv


class FeatureEnhancement(nnx.Module):
    """Five 3x3 depthwise-separable convolutions with three skip connections, joined by addition.

    Figure 4 was not published in readable form. Skips go around convolutions 2, 3 to 4, and 5, so every skip joins maps
    of the same width.

    Args:
        in_features: Channels of the raster.
        features: Channels inside and of the result.
    """

    def __init__(self, in_features: int, features: int, *, rngs: nnx.Rngs):
        self.enter = SeparableConv(in_features, features, rngs=rngs)
        self.second = SeparableConv(features, features, rngs=rngs)
        self.third = SeparableConv(features, features, rngs=rngs)
        self.fourth = SeparableConv(features, features, rngs=rngs)
        self.fifth = SeparableConv(features, features, rngs=rngs)

    def __call__(self, grid: Float[Array, "b h w c"]) -> Float[Array, "b h w d"]:
        """Enhance a raster `[b, h, w, c]`."""
        x = self.enter(grid)
        x = x + self.second(x)
        x = x + self.fourth(self.third(x))
        return x + self.fifth(x)
