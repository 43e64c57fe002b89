"""Initial weights."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

LARGEST_BUCKET = 1 << 20


def he_normal(key: Array, shape: Sequence[int], dtype: Any = jnp.float32, out_sharding: Any = None) -> Array:
    """He's initialisation, for layers before a rectifier: normal, variance 2 / fan-in, the last axis being the outputs.

    Args:
        key: Consumed.
        shape: `[..., in, out]`; leading axes are a convolution's window.
        dtype: Of the result.
        out_sharding: Ignored; Flax passes it.
    """
    del out_sharding
    return (math.sqrt(2.0 / math.prod(shape[:-1])) * _normal(key, shape)).astype(dtype)


def lecun_normal(key: Array, shape: Sequence[int], dtype: Any = jnp.float32, out_sharding: Any = None) -> Array:
    """LeCun's initialisation, for layers without a rectifier: as `he_normal`, variance 1 / fan-in."""
    del out_sharding
    return (math.sqrt(1.0 / math.prod(shape[:-1])) * _normal(key, shape)).astype(dtype)


def _normal(key: Array, shape: Sequence[int]) -> Array:
    """Standard normal numbers.

    Drawn in buckets of a few sizes and cut to shape: one random kernel is compiled for each bucket, not for each layer,
    which is most of the time to build a network otherwise.
    """
    size = math.prod(shape)
    bucket = 1 << (2 * math.ceil(max(math.log2(size), 12) / 2))
    drawn = jax.random.normal(key, (bucket if bucket <= LARGEST_BUCKET else size,))[:size]
    return drawn.reshape(tuple(shape))
