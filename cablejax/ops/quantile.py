"""Quantiles of many values without sorting them."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from cablejax.ops.varying import varying_like


def quantile(values: Float[Array, " n"], valid: Bool[Array, " n"], q: float) -> Float[Array, ""]:
    """A quantile of the valid values, interpolated linearly, as `jnp.nanquantile` gives it.

    The order of floats that are not negative is the order of their bits, which are fixed one after the other by counting:
    31 passes that XLA vectorises, where it sorts in one thread. Differentiable.

    Args:
        values: Not negative where valid `[n]`.
        valid: Which of them count `[n]`.
        q: Between 0 and 1. Static.

    Returns:
        The quantile; 0 where nothing is valid.
    """
    count = jnp.sum(valid, dtype=jnp.int32)
    place = q * (count - 1).astype(jnp.float32)
    ranks = jnp.stack([jnp.floor(place), jnp.ceil(place)])
    bits = jnp.where(valid, lax.bitcast_convert_type(lax.stop_gradient(values), jnp.int32), jnp.iinfo(jnp.int32).max)

    def fix(step: Array, found: Array) -> Array:
        trial = found | (jnp.int32(1) << (30 - step))
        below = jnp.sum(bits[None, :] < trial[:, None], axis=1, dtype=jnp.int32)
        return jnp.where(below <= ranks.astype(jnp.int32), trial, found)

    found = lax.fori_loop(jnp.int32(0), jnp.int32(31), fix, varying_like(jnp.zeros(2, dtype=jnp.int32), bits))
    low, high = (values[jnp.argmax(bits == one)] for one in found)
    return jnp.where(count > 0, low + (high - low) * (place - ranks[0]), 0.0)
