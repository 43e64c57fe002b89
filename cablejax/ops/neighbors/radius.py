"""Exact search within a radius, and counting within one, inside jit."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.brute import count_brute
from cablejax.ops.neighbors.knn import differentiable, nearest_in
from cablejax.ops.neighbors.request import Request, bit, prepare
from cablejax.ops.neighbors.tree import Tree
from cablejax.ops.neighbors.within import count_within
from cablejax.types import Status


class RadiusResult(NamedTuple):
    """The neighbours of each query within a radius.

    Attributes:
        neighbors: The nearest `capacity` of them `[n, capacity]` int32, nearest first; -1 where there are fewer.
        sq_dist: Squared distances `[n, capacity]`, inf where there are fewer. Differentiable in the coordinates.
        count: How many lie within the radius `[n]`, also beyond `capacity`.
        status: `Status` bits `[n]` int32: CAPACITY_EXCEEDED where count > capacity, NOT_FINITE. Zero on padding.
    """

    neighbors: Int[Array, "n capacity"]
    sq_dist: Float[Array, "n capacity"]
    count: Int[Array, " n"]  # pyright: ignore[reportIncompatibleMethodOverride]
    status: Int[Array, " n"]


@partial(jax.jit, static_argnames=("capacity", "include_self"))
def radius_search(
    xyz: Float[Array, "n c"],
    *,
    radius: float | Float[Array, ""],
    capacity: int,
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
) -> RadiusResult:
    """Find the points within a radius of each query: distance <= radius, up to a fixed number.

    Args:
        xyz: Points `[n, c]`, any unit.
        radius: In the unit of `xyz`, not negative.
        capacity: Neighbours kept per query, the nearest, the point itself not counted unless `include_self`. Static.
        queries: Where to search `[q, c]`; the points themselves if None.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.

    Returns:
        Neighbours, squared distances, counts and status, one row per query. Counts go beyond `capacity`, and say so.

    Raises:
        ValueError: If `capacity` is below 1, the shapes do not fit together, or coordinates are float64 or integers.
    """
    if capacity < 1:
        raise ValueError(f"capacity: expected at least 1, got {capacity}")
    cloud, own = prepare(xyz, queries, mask, include_self), queries is None
    trees = cloud.trees(own) if cloud.has_tree() else None
    nearest = nearest_in(cloud, trees, k=capacity, own=own, include_self=include_self)
    square_radius = _square(radius)
    inside = nearest.sq_dist <= square_radius
    kept = jnp.sum(inside, axis=1, dtype=jnp.int32)
    # Who found fewer than there is room for has found all; only the others need a second look.
    count = jax.lax.cond(
        jnp.any(kept == capacity), lambda: _counts(cloud, trees, square_radius, own, include_self), lambda: kept
    )
    status = (nearest.status & int(Status.NOT_FINITE)) | bit(count > capacity, Status.CAPACITY_EXCEEDED)
    neighbors = jnp.where(inside, nearest.neighbors, -1)
    sq_dist = differentiable(nearest.sq_dist, nearest.neighbors, xyz, queries)
    return RadiusResult(neighbors, jnp.where(inside, sq_dist, jnp.inf), count, status.astype(jnp.int32))


class RadiusCount(NamedTuple):
    """How many points lie within a radius.

    Attributes:
        count: Points `[n]` int32, 0 for padding.
        status: `Status` bits `[n]` int32: NOT_FINITE. Zero on padding.
    """

    count: Int[Array, " n"]  # pyright: ignore[reportIncompatibleMethodOverride]
    status: Int[Array, " n"]


@partial(jax.jit, static_argnames=("include_self",))
def radius_count(
    xyz: Float[Array, "n c"],
    *,
    radius: float | Float[Array, ""],
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
) -> RadiusCount:
    """Count the points within a radius of each query, distance <= radius; arguments and errors as `radius_search`."""
    cloud, own = prepare(xyz, queries, mask, include_self), queries is None
    trees = cloud.trees(own) if cloud.has_tree() else None
    status = bit(cloud.asked & ~cloud.finite, Status.NOT_FINITE)
    return RadiusCount(_counts(cloud, trees, _square(radius), own, include_self), status.astype(jnp.int32))


def _square(radius: float | Float[Array, ""]) -> Float[Array, ""]:
    """A radius squared, as the kernels compare with it."""
    return jnp.square(jnp.asarray(radius, dtype=jnp.float32))


def _counts(
    cloud: Request, trees: tuple[Tree, Tree] | None, square_radius: Array, own: bool, include_self: bool
) -> Int[Array, " q"]:
    """Points within the radius of each query; 0 for padding and what is not finite."""
    if trees is None:
        count = count_brute(cloud.queries, cloud.xyz, cloud.valid, cloud.skip, square_radius)
    else:
        tree, targets = trees
        count = count_within(tree, targets, cloud.queries.shape[0], square_radius, include_self=include_self or not own)
    return jnp.where(cloud.asked & cloud.finite, count, 0)
