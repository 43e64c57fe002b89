"""Exact nearest neighbours in float32, inside jit, with ties broken by row."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.dense import knn_dense
from cablejax.ops.neighbors.rank import Ranked, distance_sum, in_order, rows_in_order
from cablejax.ops.neighbors.request import Request, as_float32, bit, prepare
from cablejax.ops.neighbors.search import Finish, search
from cablejax.ops.neighbors.tree import Tree
from cablejax.types import Status


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
        k: Neighbours per query, the point itself not counted unless `include_self`. Static.
        queries: Where to search `[q, c]`; the points themselves if None.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.

    Returns:
        Neighbours, squared distances and status, one row per query; rows of padding hold -1, inf and 0.

    Raises:
        ValueError: If `k` is below 1, the shapes do not fit together, or coordinates are float64 or integers.

    Example:
        >>> result = knn(jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), k=1)
        >>> result.neighbors[:, 0].tolist(), result.sq_dist[:, 0].tolist()
        ([1, 0, 1], [1.0, 1.0, 4.0])
    """
    if k < 1:
        raise ValueError(f"k: expected at least 1, got {k}")
    cloud, own = prepare(xyz, queries, mask, include_self), queries is None
    found = nearest_in(cloud, cloud.trees(own) if cloud.has_tree() else None, k=k, own=own, include_self=include_self)
    return found._replace(sq_dist=differentiable(found.sq_dist, found.neighbors, xyz, queries))


@partial(jax.jit, static_argnames=("k",))
def distance_sums(
    xyz: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None
) -> tuple[Float[Array, " n"], Int[Array, " n"], Int[Array, " n"]]:
    """Sum of the distances to each point's k nearest others: what `knn` would give, without ranking or listing them.

    Args:
        xyz: Points `[n, c]`, any unit.
        k: Neighbours per point, the point itself not counted. Static.
        mask: True where a row is a point `[n]`; all if None.

    Returns:
        Sums `[n]`, numbers of neighbours summed `[n]`, and status as in `knn`. No gradient flows through the sums.
    """
    cloud = prepare(xyz, None, mask)
    if not cloud.has_tree():
        found = knn(jax.lax.stop_gradient(xyz), k=k, mask=mask)
        near = jnp.isfinite(found.sq_dist)
        return (
            jnp.sqrt(jnp.where(near, found.sq_dist, 0.0)).sum(axis=1),
            near.sum(axis=1, dtype=jnp.int32),
            found.status,
        )
    total, count = _own_neighbors(cloud, k, partial(distance_sum, k=k))
    usable = cloud.asked & cloud.finite
    total, count = jnp.where(usable, total, 0.0), jnp.where(usable, count, 0)
    few = usable & (count < k)
    status = bit(few, Status.TOO_FEW_NEIGHBORS) | bit(cloud.asked & ~cloud.finite, Status.NOT_FINITE)
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
    most, cloud = max(k, total_k), prepare(xyz, None, mask)
    if cloud.has_tree():

        def finish(ranked: Ranked) -> tuple[Array, ...]:
            return rows_in_order(ranked, k), *distance_sum(ranked, total_k)

        neighbors, total, count = _own_neighbors(cloud, most, finish)
        usable = cloud.asked & cloud.finite
        neighbors = jnp.where(usable[:, None], neighbors, -1)
        total, count = jnp.where(usable, total, 0.0), jnp.where(usable, count, 0)
        odd = bit(cloud.asked & ~cloud.finite, Status.NOT_FINITE)
        few = usable & (neighbors[:, -1] < 0)
    else:
        found = knn(jax.lax.stop_gradient(xyz), k=most, mask=mask)
        near = jnp.isfinite(found.sq_dist[:, :total_k])
        total, count = (
            jnp.sqrt(jnp.where(near, found.sq_dist[:, :total_k], 0.0)).sum(axis=1),
            near.sum(axis=1, dtype=jnp.int32),
        )
        neighbors, odd = found.neighbors[:, :k], found.status & int(Status.NOT_FINITE)
        usable = (odd == 0) & (jnp.ones(xyz.shape[0], dtype=bool) if mask is None else mask)
        few = usable & (neighbors[:, -1] < 0)
    status, total_status = (bit(each, Status.TOO_FEW_NEIGHBORS) | odd for each in (few, usable & (count < total_k)))
    return ListAndSums(neighbors, status.astype(jnp.int32), total, count, total_status.astype(jnp.int32))


def knn_features(features: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None) -> KnnResult:
    """The k nearest rows of each row of a small feature matrix `[n, c]`, the row itself not counted; see `knn`."""
    return knn(features, k=k, mask=mask)


def nearest_in(cloud: Request, trees: tuple[Tree, Tree] | None, *, k: int, own: bool, include_self: bool) -> KnnResult:
    """The k nearest points, with no gradient; by the trees if there are any, comparing all pairs if not."""
    if trees is None:
        neighbors, sq_dist = knn_dense(cloud.queries, cloud.xyz, cloud.valid, cloud.skip, k=k)
    else:
        tree, targets = trees
        finish = partial(in_order, k=k)
        some = include_self or not own
        neighbors, sq_dist = search(tree, targets, cloud.queries.shape[0], k=k, include_self=some, finish=finish)
    usable = cloud.asked & cloud.finite
    neighbors, sq_dist = jnp.where(usable[:, None], neighbors, -1), jnp.where(usable[:, None], sq_dist, jnp.inf)
    few = usable & (neighbors[:, -1] < 0)
    status = bit(few, Status.TOO_FEW_NEIGHBORS) | bit(cloud.asked & ~cloud.finite, Status.NOT_FINITE)
    return KnnResult(neighbors, sq_dist, status.astype(jnp.int32))


def differentiable(sq_dist: Array, neighbors: Array, xyz: Array, queries: Array | None) -> Float[Array, "q k"]:
    """Squared distances as a search found them, with the gradient that they have in the coordinates."""
    return _differentiable(
        sq_dist, neighbors, as_float32(xyz, "xyz"), as_float32(xyz if queries is None else queries, "")
    )


def _own_neighbors(cloud: Request, k: int, finish: Finish) -> tuple[Array, ...]:
    """What `finish` makes of the neighbours of every point."""
    tree, targets = cloud.trees(True)
    return search(tree, targets, cloud.xyz.shape[0], k=k, include_self=False, finish=finish)


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
