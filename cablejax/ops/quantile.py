"""Quantiles of many values without sorting them."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from cablejax.ops.neighbors.kth import kth_smallest


def quantile(values: Float[Array, " n"], valid: Bool[Array, " n"], q: float) -> Float[Array, ""]:
    """A quantile of the valid values, interpolated linearly, as `jnp.nanquantile` gives it.

    Found by counting (`kth_smallest`). Differentiable.

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
    found = kth_smallest(jnp.broadcast_to(bits[None, :], (2, bits.shape[0])), ranks.astype(jnp.int32))
    low, high = (values[jnp.argmax(bits == one)] for one in found)
    return jnp.where(count > 0, low + (high - low) * (place - ranks[0]), 0.0)
