"""The k-th smallest of many numbers by counting: passes that XLA vectorises on a CPU, where it sorts in one thread."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from cablejax.ops.varying import varying_like


def kth_smallest(bits: Int[Array, "*b n"], rank: Int[Array, "*b"] | int, *, coarse: int = 0) -> Int[Array, "*b"]:
    """The number of a given rank in each row, by fixing one bit after the other.

    Args:
        bits: Numbers `[..., n]`, none of them negative: integers, or the bits of floats, whose order is theirs.
        rank: How many are before it, counted from 0 `[...]`; below n.
        coarse: Low bits that are not searched and come back as 0. Static.

    Returns:
        The numbers `[...]` int32, or with `coarse` what they begin with.
    """

    def fix(step: Array, found: Array) -> Array:
        trial = found | (jnp.int32(1) << (30 - step))
        below = jnp.sum(bits < trial[..., None], axis=-1, dtype=jnp.int32)
        return jnp.where(below <= rank, trial, found)

    found = varying_like(jnp.zeros(bits.shape[:-1], dtype=jnp.int32), bits, rank)
    return lax.fori_loop(jnp.int32(0), jnp.int32(31 - coarse), fix, found)
