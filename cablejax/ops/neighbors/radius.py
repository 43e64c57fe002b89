"""Exact search within a radius, and counting within one, inside jit."""

from functools import partial

import jax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.index import RadiusCount, RadiusResult, count_of, tree_of, within_of


@partial(jax.jit, static_argnames=("capacity", "include_self"))
def radius_search(
    xyz: Float[Array, "n c"],
    *,
    radius: float | Float[Array, ""],
    capacity: int,
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
    query_row_splits: Int[Array, " b1"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> RadiusResult:
    """Find the points within a radius of each query: distance <= radius, up to a fixed number.

    Args:
        xyz: Points `[n, c]`, any unit.
        radius: In the unit of `xyz`; one that is negative or NaN leaves `Status.INVALID`.
        capacity: Neighbours kept per query, the nearest, the point itself not counted unless `include_self`. Static.
        queries: Where to search `[q, c]`; the points themselves if None.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.
        row_splits: Of a ragged batch, see `build_tree` `[b + 1]`; one cloud if None.
        query_row_splits: Of the queries, where there are both `[b + 1]`.
        box: Lengths of a periodic box, see `build_tree` `[c]`; open space if None.

    Returns:
        Neighbours, squared distances, counts and status, one row per query. Counts go beyond `capacity`, and say so.

    Raises:
        ValueError: If `capacity` is below 1, the shapes do not fit together, or coordinates are float64 or integers.
    """
    tree = tree_of(xyz, mask, row_splits, box)
    return within_of(tree, queries, query_row_splits, radius, capacity=capacity, include_self=include_self)


@partial(jax.jit, static_argnames=("include_self",))
def radius_count(
    xyz: Float[Array, "n c"],
    *,
    radius: float | Float[Array, ""],
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
    query_row_splits: Int[Array, " b1"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> RadiusCount:
    """Count the points within a radius of each query, distance <= radius; arguments and errors as `radius_search`."""
    tree = tree_of(xyz, mask, row_splits, box)
    return count_of(tree, queries, query_row_splits, radius, include_self=include_self)
