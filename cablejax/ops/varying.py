"""Loops inside `shard_map`: a carry that starts as a constant must be said to vary as what the loop makes of it does."""

from typing import Any, TypeVar

import jax

T = TypeVar("T")


def varying_like(tree: T, *like: Any) -> T:
    """The same arrays, typed as varying over every mesh axis over which any array of `like` varies.

    Outside `shard_map` nothing varies and this does nothing.
    """
    axes = frozenset().union(*(_axes(leaf) for leaf in jax.tree.leaves(like)))

    def cast(array: jax.Array) -> jax.Array:
        missing = tuple(sorted(axes - _axes(array)))
        return jax.lax.pcast(array, missing, to="varying") if missing else array

    return jax.tree.map(cast, tree) if axes else tree


def _axes(array: Any) -> frozenset[str]:
    """Mesh axes over which an array varies: `vma` in newer jax."""
    kind: Any = jax.typeof(array)
    return kind.vma if hasattr(kind, "vma") else kind.manual_axis_type.varying
