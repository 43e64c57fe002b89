"""Exact nearest neighbours and radius search in float32, inside jit, with ties broken by index."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors_brute import count_brute, knn_brute
from cablejax.ops.neighbors_rank import in_order
from cablejax.ops.neighbors_search import search
from cablejax.ops.neighbors_tree import build, depth_for
from cablejax.types import Status

BRUTE_POINTS = 4096  # up to here comparing all pairs costs less than a tree


class KnnResult(NamedTuple):
    """The k nearest neighbours of each query.

    Attributes:
        neighbors: Rows of `xyz` `[n, k]` int32, nearest first, equal distances by row; -1 where none is left.
        sq_dist: Squared distances `[n, k]`, inf where none is left. Differentiable in the coordinates.
        status: `Status` bits `[n]` int32: TOO_FEW_NEIGHBORS, NOT_FINITE. Zero on padding.
    """

    neighbors: Int[Array, "n k"]
    sq_dist: Float[Array, "n k"]
    status: Int[Array, " n"]


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


@partial(jax.jit, static_argnames=("k", "include_self"))
def knn(
    xyz: Float[Array, "n c"],
    *,
    k: int,
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
) -> KnnResult:
    """Find the k nearest points of each query, exactly.

    Distances are float32 sums of squared differences; of two points equally far the one with the lower row comes first.
    Points whose mask is False or whose coordinates are not finite are nobody's neighbour.

    Args:
        xyz: Points `[n, c]`, any unit.
        k: Neighbours per query. Static.
        queries: Where to search `[q, c]`; the points themselves if None.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.

    Returns:
        Neighbours, squared distances and status, one row per query; rows of padding hold -1, inf and 0.

    Raises:
        ValueError: If `k` is below 1 or the shapes do not fit together.

    Example:
        >>> result = knn(jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), k=1)
        >>> result.neighbors[:, 0].tolist(), result.sq_dist[:, 0].tolist()
        ([1, 0, 1], [1.0, 1.0, 4.0])
    """
    if k < 1:
        raise ValueError(f"k: expected at least 1, got {k}")
    cloud = _prepare(xyz, queries, mask, include_self)
    if xyz.shape[1] == 3 and xyz.shape[0] > BRUTE_POINTS:
        neighbors = _tree_knn(cloud, queries is None, include_self, k)
    else:
        neighbors, _ = knn_brute(cloud.queries, cloud.xyz, cloud.valid, cloud.skip, k=k)
    neighbors = jnp.where(cloud.asked[:, None] & cloud.finite[:, None], neighbors, -1)
    sq_dist = _measure(xyz, xyz if queries is None else queries, neighbors)
    few = cloud.asked & cloud.finite & (neighbors[:, -1] < 0)
    status = few * int(Status.TOO_FEW_NEIGHBORS) | (cloud.asked & ~cloud.finite) * int(Status.NOT_FINITE)
    return KnnResult(neighbors, sq_dist, status.astype(jnp.int32))


def knn_features(features: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None) -> KnnResult:
    """The k nearest rows of each row of a small feature matrix `[n, c]`, the row itself not counted; see `knn`."""
    return knn(features, k=k, mask=mask)


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
        capacity: Neighbours kept per query, the nearest. Static.
        queries: Where to search `[q, c]`; the points themselves if None.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.

    Returns:
        Neighbours, squared distances, counts and status, one row per query. Counts go beyond `capacity`, and say so.

    Raises:
        ValueError: If `capacity` is below 1 or the shapes do not fit together.
    """
    if capacity < 1:
        raise ValueError(f"capacity: expected at least 1, got {capacity}")
    nearest = knn(xyz, k=capacity, queries=queries, mask=mask, include_self=include_self)
    count = radius_count(xyz, radius=radius, queries=queries, mask=mask, include_self=include_self)
    inside = nearest.sq_dist <= jnp.square(jnp.asarray(radius, dtype=xyz.dtype))
    status = (nearest.status & int(Status.NOT_FINITE)) | (count > capacity) * int(Status.CAPACITY_EXCEEDED)
    neighbors = jnp.where(inside, nearest.neighbors, -1)
    return RadiusResult(neighbors, jnp.where(inside, nearest.sq_dist, jnp.inf), count, status.astype(jnp.int32))


@partial(jax.jit, static_argnames=("include_self",))
def radius_count(
    xyz: Float[Array, "n c"],
    *,
    radius: float | Float[Array, ""],
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
) -> Int[Array, " q"]:
    """Count the points within a radius of each query, distance <= radius; arguments as `radius_search`."""
    cloud = _prepare(xyz, queries, mask, include_self)
    square_radius = jnp.square(jnp.asarray(radius, dtype=xyz.dtype))
    count = count_brute(cloud.queries, cloud.xyz, cloud.valid, cloud.skip, square_radius)
    return jnp.where(cloud.asked & cloud.finite, count, 0)


def _tree_knn(cloud: "_Search", own: bool, include_self: bool, k: int) -> Array:
    """Neighbours `[q, k]` by the tree; queries that are not the points get a tree of their own."""
    depth = depth_for(cloud.xyz.shape[0])
    tree = build(cloud.xyz, cloud.valid, depth=depth)
    targets = tree if own else build(cloud.queries, cloud.asked & cloud.finite, depth=depth)
    first = partial(in_order, k=k)
    found, _ = search(cloud.xyz, tree, targets, k=k, include_self=include_self or not own, finish=first)
    row = targets.row.reshape(-1)
    q = cloud.queries.shape[0]
    place = jnp.zeros(q, dtype=jnp.int32).at[jnp.where(row < 0, q, row)].set(jnp.arange(row.size), mode="drop")
    return found[place]


class _Search(NamedTuple):
    """A search with its defaults filled in; gradients stopped, non-finite points made invalid."""

    xyz: Float[Array, "n c"]
    valid: Bool[Array, " n"]
    queries: Float[Array, "q c"]
    asked: Bool[Array, " q"]
    finite: Bool[Array, " q"]
    skip: Int[Array, " q"]


def _prepare(xyz: Array, queries: Array | None, mask: Array | None, include_self: bool) -> _Search:
    """Fill in the defaults of a search; `skip` is the row that a query must not find, -1 for none."""
    if xyz.ndim != 2 or xyz.shape[0] < 1:
        raise ValueError(f"xyz: expected shape [n, c] with n at least 1, got {list(xyz.shape)}")
    if queries is not None and (queries.ndim != 2 or queries.shape[1] != xyz.shape[1]):
        raise ValueError(f"queries: expected shape [q, {xyz.shape[1]}], got {list(queries.shape)}")
    if mask is not None and mask.shape != xyz.shape[:1]:
        raise ValueError(f"mask: expected shape [{xyz.shape[0]}], got {list(mask.shape)}")
    mask = jnp.ones(xyz.shape[0], dtype=bool) if mask is None else mask
    xyz = jax.lax.stop_gradient(xyz)
    finite = jnp.isfinite(xyz).all(axis=1)
    valid = mask & finite
    clean = jnp.where(valid[:, None], xyz, 0.0)
    if queries is None:
        skip = jnp.full(xyz.shape[0], -1) if include_self else jnp.arange(xyz.shape[0])
        return _Search(clean, valid, clean, mask, finite, skip)
    queries = jax.lax.stop_gradient(queries)
    query_finite = jnp.isfinite(queries).all(axis=1)
    asked = jnp.ones(queries.shape[0], dtype=bool)
    queries = jnp.where(query_finite[:, None], queries, 0.0)
    return _Search(clean, valid, queries, asked, query_finite, jnp.full(queries.shape[0], -1))


def _measure(xyz: Array, queries: Array, neighbors: Array) -> Array:
    """Squared distances `[q, k]` from the neighbours' own coordinates: exact, and differentiable."""
    found = neighbors >= 0
    difference = queries[:, None, :] - xyz[jnp.maximum(neighbors, 0)]
    # Double where: a NaN in a row that is not used must not reach the gradient.
    return jnp.where(found, jnp.square(jnp.where(found[..., None], difference, 0.0)).sum(axis=-1), jnp.inf)
