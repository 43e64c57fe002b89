"""From point features to logits: symmetric pooling and the fully connected classifier."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.init import he_normal, lecun_normal
from cablejax.nets.norm import BatchNorm


def pool_points(points: Float[Array, "b n c"], mask: Bool[Array, "b n"], *, mean: bool = True) -> Float[Array, "b d"]:
    """Maximum and mean over the valid points, concatenated to `[b, 2c]`; the maximum alone if `mean` is False."""
    largest = jnp.max(points, axis=1, where=mask[..., None], initial=-jnp.inf)
    largest = jnp.where(jnp.any(mask, axis=1)[:, None], largest, 0.0)
    if not mean:
        return largest
    count = jnp.maximum(jnp.sum(mask, axis=1), 1)
    average = jnp.sum(points, axis=1, where=mask[..., None]) / count[:, None]
    return jnp.concatenate([largest, average], axis=-1)


class Classifier(nnx.Module):
    """Fully connected layers with batch normalisation, LeakyReLU and dropout, then the logits.

    Args:
        in_features: Channels of the pooled feature.
        widths: Channels of the hidden layers.
        num_classes: C.
        dropout: Rate after every hidden layer; 0 leaves it out.
        negative_slope: LeakyReLU's slope below zero.
    """

    def __init__(
        self,
        in_features: int,
        widths: Sequence[int],
        num_classes: int,
        *,
        dropout: float = 0.0,
        negative_slope: float = 0.2,
        rngs: nnx.Rngs,
    ):
        self.negative_slope = negative_slope
        sizes = [in_features, *widths]
        self.hidden = nnx.List(
            [
                nnx.Linear(c, d, use_bias=False, kernel_init=he_normal, rngs=rngs)
                for c, d in zip(sizes[:-1], widths, strict=True)
            ]
        )
        self.norms = nnx.List([BatchNorm(d) for d in widths])
        self.dropout = nnx.Dropout(dropout, rngs=rngs) if dropout > 0 else None
        self.logits = nnx.Linear(sizes[-1], num_classes, kernel_init=lecun_normal, rngs=rngs)

    def __call__(self, x: Float[Array, "b c"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]`."""
        for linear, norm in zip(self.hidden, self.norms, strict=True):
            x = jax.nn.leaky_relu(norm(linear(x)), self.negative_slope)
            x = x if self.dropout is None else self.dropout(x)
        return self.logits(x)
