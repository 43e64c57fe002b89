"""How a kernel written for one cloud runs over a batch of them."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jaxtyping import Array


def cloud_by_cloud(function: Callable[..., Any], *, everywhere: bool = False) -> Callable[..., Any]:
    """Make `vmap` of a function a loop over the batch on the CPU.

    A cloud's arrays then stay in the cache, and XLA cannot take what one cloud needs for shared work of all that use it
    and write it to memory: a loop's body is a fence. Other devices get the plain batch, unless it is to be a loop
    everywhere: under `vmap` both branches of a condition are computed, and the longest loop of a batch is everybody's.

    Args:
        function: Of arrays alone, or trees of them, to an array or a tree of them.
        everywhere: Whether other devices loop as well.
    """

    def run(*trees: Any) -> Any:
        leaves, structure = jax.tree.flatten(trees)
        return _loop_under_vmap(lambda *leaves: function(*jax.tree.unflatten(structure, leaves)), everywhere)(*leaves)

    return run


def _loop_under_vmap(function: Callable[..., Any], everywhere: bool) -> Callable[..., Any]:
    """`cloud_by_cloud` of a function of arrays."""
    wrapped = jax.custom_batching.custom_vmap(function)

    @wrapped.def_vmap
    def _(size: int, batched: Sequence[bool], *arrays: Array) -> tuple[Any, Any]:
        del size

        def looped(arrays: tuple[Array, ...]) -> Any:
            def one(rows: list[Array]) -> Any:
                own = iter(rows)
                return wrapped(*(next(own) if b else a for a, b in zip(arrays, batched, strict=True)))

            return jax.lax.map(one, [a for a, b in zip(arrays, batched, strict=True) if b])

        def together(arrays: tuple[Array, ...]) -> Any:
            return jax.vmap(function, in_axes=[0 if b else None for b in batched])(*arrays)

        out = looped(arrays) if everywhere else jax.lax.platform_dependent(arrays, cpu=looped, default=together)
        return out, jax.tree.map(lambda _: True, out)

    return wrapped
