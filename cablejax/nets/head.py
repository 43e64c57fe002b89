"""From point features to logits: a layer shared by all points, symmetric pooling, the fully connected classifier."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.init import he_normal, lecun_normal
from cablejax.nets.norm import BatchNorm
from cablejax.ops.maximum import largest
from cablejax.ops.product import gram, row_product


def pool_points(points: Float[Array, "n c"], mask: Bool[Array, " n"], *, mean: bool = True) -> Float[Array, " d"]:
    """Maximum and mean over a cloud's valid points, concatenated to `[2c]`; the maximum alone if `mean` is False."""
    maximum = largest(jnp.where(mask[:, None], points, -jnp.inf), 0)
    maximum = jnp.where(jnp.any(mask), maximum, 0.0)
    if not mean:
        return maximum
    average = jnp.sum(points, axis=0, where=mask[:, None]) / jnp.maximum(jnp.sum(mask), 1)
    return jnp.concatenate([maximum, average])


class PooledLayer(nnx.Module):
    """A layer shared by all points, batch normalisation, LeakyReLU, then the maximum and the mean over the points.

    No tensor of the layer's width is kept for the whole batch: its mean follows from that of its input, its variance
    from the input's covariance, `diag(W^T C W)` (accurate to about 1e-6 of what the largest direction of C would give),
    and a cloud is multiplied, activated and pooled while it is in the cache.

    Args:
        in_features: Channels of the points.
        features: Channels of the layer; the result has twice as many.
        negative_slope: LeakyReLU's slope below zero.
    """

    def __init__(self, in_features: int, features: int, *, negative_slope: float = 0.2, rngs: nnx.Rngs):
        self.negative_slope = negative_slope
        self.kernel = nnx.Param(he_normal(rngs.params(), (in_features, features), jnp.float32))
        self.norm = BatchNorm(features)

    def __call__(self, x: Float[Array, "b n c"], mask: Bool[Array, "b n"]) -> Float[Array, "b pooled"]:
        """Pooled features of clouds `[b, n, c]`; rows where `mask` is False change nothing."""
        if self.norm.use_running_average:
            mean, var = self.norm.mean[...], self.norm.var[...]
        else:
            mean, var = self._statistics(x, mask.astype(x.dtype))
            self.norm.update(mean, var)
        scale, shift = self.norm.fold(mean, var)
        kernel = self.kernel[...] * scale[None, :]

        @jax.checkpoint  # multiplying again is quicker than keeping a tensor of this width
        def one(cloud: tuple[Array, Array]) -> Array:
            points, valid = cloud
            activated = jax.nn.leaky_relu(row_product(points, kernel) + shift[None, :], self.negative_slope)
            return pool_points(activated, valid)

        return jax.lax.map(one, (x, mask)) if jax.default_backend() == "cpu" else jax.vmap(one)((x, mask))

    def _statistics(self, x: Float[Array, "b n c"], weight: Float[Array, "b n"]) -> tuple[Array, Array]:
        """Mean and variance `[d]` of the layer's product over the valid points."""
        total = jnp.maximum(jnp.sum(weight), 1.0)
        mean = jnp.sum(x * weight[..., None], axis=(0, 1)) / total
        covariance = gram((x - mean[None, None, :]) * weight[..., None]) / total
        kernel = self.kernel[...]
        spread = jnp.matmul(covariance, kernel, precision=jax.lax.Precision.HIGHEST)
        return mean @ kernel, jnp.maximum(jnp.sum(kernel * spread, axis=0), 0.0)


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
        return self.logits(self.last_hidden(x))

    def last_hidden(self, x: Float[Array, "b c"]) -> Float[Array, "b d"]:
        """The last hidden layer's output, of which the logits are linear functions."""
        for linear, norm in zip(self.hidden, self.norms, strict=True):
            x = jax.nn.leaky_relu(norm(linear(x)), self.negative_slope)
            x = x if self.dropout is None else self.dropout(x)
        return x
