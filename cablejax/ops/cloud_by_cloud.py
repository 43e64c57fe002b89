"""How a kernel written for one cloud runs over a batch of them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array


def cloud_by_cloud(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make `vmap` of a function a loop over the batch on the CPU.

    A cloud's arrays then stay in the cache, and XLA cannot take what one cloud needs for shared work of all that use it
    and write it to memory: a loop's body is a fence. Other devices get the plain batch.

    Args:
        function: Of arrays alone, to an array or a tree of them.
    """
    wrapped = jax.custom_batching.custom_vmap(function)

    @wrapped.def_vmap
    def _(size: int, batched: Sequence[bool], *arrays: Array) -> tuple[Any, Any]:
        every = [a if b else jnp.broadcast_to(a, (size, *a.shape)) for a, b in zip(arrays, batched, strict=True)]
        looped = partial(jax.lax.map, lambda rows: wrapped(*rows))  # wrapped: a second vmap is a loop as well
        out = jax.lax.platform_dependent(tuple(every), cpu=looped, default=lambda rows: jax.vmap(function)(*rows))
        return out, jax.tree.map(lambda _: True, out)

    return wrapped
