"""Batch normalisation whose statistics skip padding."""

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float


class BatchNorm(nnx.Module):
    """Normalise each channel by the mean and variance of the valid rows, then scale and shift.

    In training the batch's statistics are used and blended into the running ones; in evaluation the running ones. The
    variance is the mean squared deviation from the mean (two passes): the usual `E[x^2] - E[x]^2` cancels in float32.

    Args:
        features: Channels, the last axis.
        momentum: Share of the old running statistic that is kept at each step. Flax's .99 needs hundreds of steps.
        epsilon: Added to the variance.
    """

    def __init__(self, features: int, *, momentum: float = 0.9, epsilon: float = 1e-5):
        self.momentum = momentum
        self.epsilon = epsilon
        self.use_running_average = False
        self.scale = nnx.Param(jnp.ones(features))
        self.bias = nnx.Param(jnp.zeros(features))
        self.mean = nnx.BatchStat(jnp.zeros(features))
        self.var = nnx.BatchStat(jnp.ones(features))

    def __call__(self, x: Float[Array, "*rows c"], weight: Float[Array, "*rows"] | None = None) -> Array:
        """Normalise `[..., c]`; rows of weight 0 do not count (None: all count)."""
        if self.use_running_average:
            return self.apply(x, *self.fold(self.mean[...], self.var[...]))
        axes = tuple(range(x.ndim - 1))
        if weight is None:
            mean = jnp.mean(x, axis=axes)
            var = jnp.mean(self._centred(x, mean) ** 2, axis=axes)
        else:
            total = jnp.maximum(jnp.sum(weight), 1.0)
            mean = jnp.sum(x * weight[..., None], axis=axes) / total
            var = jnp.sum(self._centred(x, mean) ** 2 * weight[..., None], axis=axes) / total
        self.update(mean, var)
        return self.apply(x, *self.fold(mean, var))

    @staticmethod
    def _centred(x: Array, mean: Array) -> Array:
        return x - jnp.reshape(mean, (1,) * (x.ndim - 1) + mean.shape)

    def update(self, mean: Float[Array, " c"], var: Float[Array, " c"]) -> None:
        """Blend a batch's statistics `[c]` into the running ones."""
        keep = self.momentum
        self.mean[...] = keep * self.mean[...] + (1.0 - keep) * jax.lax.stop_gradient(mean)
        self.var[...] = keep * self.var[...] + (1.0 - keep) * jax.lax.stop_gradient(var)

    def fold(self, mean: Float[Array, " c"], var: Float[Array, " c"]) -> tuple[Array, Array]:
        """The normalisation as `(scale, shift)`, each `[c]`: `y = x * scale + shift`."""
        scale = self.scale[...] * jax.lax.rsqrt(var + self.epsilon)
        return scale, self.bias[...] - mean * scale

    @staticmethod
    def apply(x: Float[Array, "*rows c"], scale: Float[Array, " c"], shift: Float[Array, " c"]) -> Array:
        """`x * scale + shift` along the last axis."""
        lead = (1,) * (x.ndim - 1)
        return x * scale.reshape(*lead, -1) + shift.reshape(*lead, -1)
