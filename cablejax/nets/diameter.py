"""The regression head: a diameter in mm and how far it may be off."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from cablejax.nets.init import lecun_normal
from cablejax.nets.input_channels import RADIUS_MM, RADIUS_SPREAD_MM

LEAST_STD_MM = 1e-3  # keeps the likelihood finite where a few clouds are met exactly


class SizeEstimate(NamedTuple):
    """What a network with a regression head says of clouds.

    Attributes:
        logits: Of the C classes `[b, C]`.
        diameter_mm: Mean of the Gaussian that it gives the outer diameter `[b]`.
        std_mm: Its standard deviation `[b]`.
    """

    logits: Float[Array, "b classes"]
    diameter_mm: Float[Array, " b"]
    std_mm: Float[Array, " b"]


class DiameterHead(nnx.Module):
    """Mean and standard deviation of the diameter, linear in the classifier's last hidden layer.

    The mean is counted from the middle of the catalogue in its spread; a softplus makes the standard deviation positive.

    Args:
        features: Channels of that layer.
    """

    def __init__(self, features: int, *, rngs: nnx.Rngs):
        self.linear = nnx.Linear(features, 2, kernel_init=lecun_normal, rngs=rngs)

    def __call__(self, x: Float[Array, "b c"]) -> tuple[Float[Array, " b"], Float[Array, " b"]]:
        """`(diameter_mm [b], std_mm [b])`."""
        middle, width = jnp.moveaxis(self.linear(x), -1, 0)
        spread = 2.0 * RADIUS_SPREAD_MM
        return 2.0 * RADIUS_MM + spread * middle, spread * jax.nn.softplus(width) + LEAST_STD_MM
