"""Exact nearest neighbours and radius search in float32, inside jit, with ties broken by index."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors_brute import count_brute
from cablejax.ops.neighbors_dense import knn_dense
from cablejax.ops.neighbors_rank import Ranked, distance_sum, in_order, rows_in_order
from cablejax.ops.neighbors_search import Finish, search
from cablejax.ops.neighbors_tree import Tree, build, depth_for
from cablejax.ops.neighbors_within import count_within
from cablejax.types import Status

BRUTE_POINTS = 2048  # up to here comparing all pairs costs about as little as a tree, which takes seconds to compile


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
    if _has_tree(xyz):
        neighbors, sq_dist = _by_tree(cloud, queries is None, include_self, k, partial(in_order, k=k))
    else:
        neighbors, sq_dist = knn_dense(cloud.queries, cloud.xyz, cloud.valid, cloud.skip, k=k)
    usable = (cloud.asked & cloud.finite)[:, None]
    neighbors, sq_dist = jnp.where(usable, neighbors, -1), jnp.where(usable, sq_dist, jnp.inf)
    sq_dist = _differentiable(sq_dist, neighbors, xyz, xyz if queries is None else queries)
    few = cloud.asked & cloud.finite & (neighbors[:, -1] < 0)
    status = few * int(Status.TOO_FEW_NEIGHBORS) | (cloud.asked & ~cloud.finite) * int(Status.NOT_FINITE)
    return KnnResult(neighbors, sq_dist, status.astype(jnp.int32))


@partial(jax.jit, static_argnames=("k",))
def distance_sums(
    xyz: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None
) -> tuple[Float[Array, " n"], Int[Array, " n"], Int[Array, " n"]]:
    """Sum of the distances to each point's k nearest others: what `knn` would give, without ranking or listing them.

    Args:
        xyz: Points `[n, c]`, any unit.
        k: Neighbours per point. Static.
        mask: True where a row is a point `[n]`; all if None.

    Returns:
        Sums `[n]`, numbers of neighbours summed `[n]`, and status as in `knn`. No gradient flows through the sums.
    """
    if not _has_tree(xyz):
        found = knn(xyz, k=k, mask=mask)
        near = jnp.isfinite(found.sq_dist)
        return jnp.sqrt(jnp.where(near, found.sq_dist, 0.0)).sum(axis=1), near.sum(axis=1), found.status
    cloud = _prepare(xyz, None, mask, False)
    total, count = _by_tree(cloud, True, False, k, partial(distance_sum, k=k))
    usable = cloud.asked & cloud.finite
    total, count = jnp.where(usable, total, 0.0), jnp.where(usable, count, 0)
    few = usable & (count < k)
    status = few * int(Status.TOO_FEW_NEIGHBORS) | (cloud.asked & ~cloud.finite) * int(Status.NOT_FINITE)
    return total, count, status.astype(jnp.int32)


class ListAndSums(NamedTuple):
    """What outlier removal and a filter after it need of one search.

    Attributes:
        neighbors: As `knn` `[n, k]`.
        status: As `knn` `[n]`.
        total: As `distance_sums` `[n]`, like what follows.
        count: Numbers of neighbours summed `[n]`.
        total_status: Status of the sums `[n]`.
    """

    neighbors: Int[Array, "n k"]
    status: Int[Array, " n"]
    total: Float[Array, " n"]
    count: Int[Array, " n"]  # pyright: ignore[reportIncompatibleMethodOverride]
    total_status: Int[Array, " n"]


@partial(jax.jit, static_argnames=("k", "total_k"))
def neighbors_and_sums(
    xyz: Float[Array, "n c"], *, k: int, total_k: int, mask: Bool[Array, " n"] | None = None
) -> ListAndSums:
    """The neighbours of `knn` without their distances, and the sums of `distance_sums` over `total_k`, by one search."""
    most = max(k, total_k)
    if _has_tree(xyz):
        cloud = _prepare(xyz, None, mask, False)

        def finish(ranked: Ranked) -> tuple[Array, ...]:
            return rows_in_order(ranked, k), *distance_sum(ranked, total_k)

        neighbors, total, count = _by_tree(cloud, True, False, most, finish)
        usable = cloud.asked & cloud.finite
        neighbors = jnp.where(usable[:, None], neighbors, -1)
        total, count = jnp.where(usable, total, 0.0), jnp.where(usable, count, 0)
        odd = (cloud.asked & ~cloud.finite) * int(Status.NOT_FINITE)
        few = usable & (neighbors[:, -1] < 0)
    else:
        found = knn(xyz, k=most, mask=mask)
        near = jnp.isfinite(found.sq_dist[:, :total_k])
        total, count = jnp.sqrt(jnp.where(near, found.sq_dist[:, :total_k], 0.0)).sum(axis=1), near.sum(axis=1)
        neighbors, odd = found.neighbors[:, :k], found.status & int(Status.NOT_FINITE)
        usable = (odd == 0) & (jnp.ones(xyz.shape[0], dtype=bool) if mask is None else mask)
        few = usable & (neighbors[:, -1] < 0)
    status, total_status = (each * int(Status.TOO_FEW_NEIGHBORS) | odd for each in (few, usable & (count < total_k)))
    return ListAndSums(neighbors, status.astype(jnp.int32), total, count, total_status.astype(jnp.int32))


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
    if _has_tree(xyz):
        tree, targets = _trees(cloud, queries is None)
        found = count_within(cloud.xyz, cloud.valid, tree, targets, square_radius)[
            _places(targets, cloud.queries.shape[0])
        ]
        # The point itself lies within any radius; `skip` is its row where it must not count.
        count = found - (cloud.skip >= 0)
    else:
        count = count_brute(cloud.queries, cloud.xyz, cloud.valid, cloud.skip, square_radius)
    return jnp.where(cloud.asked & cloud.finite, count, 0)


def _has_tree(xyz: Array) -> bool:
    """Whether a cloud is searched by a tree."""
    return xyz.shape[1] == 3 and xyz.shape[0] > BRUTE_POINTS


def _by_tree(cloud: "_Search", own: bool, include_self: bool, k: int, finish: Finish) -> tuple[Array, ...]:
    """What `finish` makes of each query's neighbours; queries that are not the points get a tree of their own."""
    tree, targets = _trees(cloud, own)
    found = search(cloud.xyz, tree, targets, k=k, include_self=include_self or not own, finish=finish)
    place = _places(targets, cloud.queries.shape[0])
    return tuple(array[place] for array in found)


def _trees(cloud: "_Search", own: bool) -> tuple[Tree, Tree]:
    """The points and the queries as trees of one depth."""
    depth = depth_for(cloud.xyz.shape[0])
    tree = build(cloud.xyz, cloud.valid, depth=depth)
    return tree, tree if own else build(cloud.queries, cloud.asked & cloud.finite, depth=depth)


def _places(targets: Tree, q: int) -> Int[Array, " q"]:
    """The place of each query in its tree; 0 for those that are not in it."""
    row = targets.row.reshape(-1)
    return jnp.zeros(q, dtype=jnp.int32).at[jnp.where(row < 0, q, row)].set(jnp.arange(row.size), mode="drop")


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


@jax.custom_jvp
def _differentiable(sq_dist: Array, neighbors: Array, xyz: Array, queries: Array) -> Array:
    """Squared distances `[q, k]` as the search found them, with the gradient that they have in the coordinates."""
    del neighbors, xyz, queries
    return sq_dist


@_differentiable.defjvp
def _differentiable_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    sq_dist, neighbors, xyz, queries = primals
    *_, moved, moved_queries = tangents
    at, found = jnp.maximum(neighbors, 0), (neighbors >= 0)[:, :, None]
    # Where there is no neighbour both factors are zero: a NaN in a row that is not used must not reach the gradient.
    difference = jnp.where(found, queries[:, None, :] - xyz[at], 0.0)
    change = jnp.where(found, moved_queries[:, None, :] - moved[at], 0.0)
    return sq_dist, 2.0 * jnp.sum(difference * change, axis=-1)
