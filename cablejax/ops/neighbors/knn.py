"""Exact nearest neighbours in float32, inside jit, with ties broken by row."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.index import KnnResult, SearchTree, by_tree, knn_of, nearest_in, tree_of
from cablejax.ops.neighbors.rank import Ranked, distance_sum, rows_in_order
from cablejax.ops.neighbors.request import Points, bit
from cablejax.ops.neighbors.search import Finish
from cablejax.types import Status


@partial(jax.jit, static_argnames=("k", "include_self"))
def knn(
    xyz: Float[Array, "n c"],
    *,
    k: int,
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
    query_row_splits: Int[Array, " b1"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> KnnResult:
    """Find the k nearest points of each query, exactly.

    Distances are float32 sums of squared differences; of two points equally far the one with the lower row comes first.
    Points whose mask is False or whose coordinates are not finite are nobody's neighbour. It is `build_tree` and `query`:
    call those where one cloud is asked more than once.

    Args:
        xyz: Points `[n, c]`, any unit.
        k: Neighbours per query, the point itself not counted unless `include_self`. Static.
        queries: Where to search `[q, c]`; the points themselves if None.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.
        row_splits: Of a ragged batch, see `build_tree` `[b + 1]`; one cloud if None.
        query_row_splits: Of the queries, where there are both `[b + 1]`.
        box: Lengths of a periodic box, see `build_tree` `[c]`; open space if None.

    Returns:
        Neighbours, squared distances and status, one row per query; rows of padding hold -1, inf and 0.

    Raises:
        ValueError: If `k` is below 1, the shapes do not fit together, or coordinates are float64 or integers.

    Example:
        >>> result = knn(jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), k=1)
        >>> result.neighbors[:, 0].tolist(), result.sq_dist[:, 0].tolist()
        ([1, 0, 1], [1.0, 1.0, 4.0])
    """
    tree = tree_of(xyz, mask, row_splits, box)
    return knn_of(tree, queries, query_row_splits, k=k, include_self=include_self)


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
    tree = tree_of(xyz, mask, None, None)
    points = tree.points()
    if tree.tree is None:
        total, count = _sums(nearest_in(tree, points, None, k=k, include_self=False).sq_dist)
    else:
        total, count = _own_neighbors(tree, points, k, partial(distance_sum, k=k))
    usable = points.usable()
    total, count = jnp.where(usable, total, 0.0), jnp.where(usable, count, 0)
    return total, count, points.status() | bit(usable & (count < k), Status.TOO_FEW_NEIGHBORS)


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
    """The neighbours of `knn` without their distances, and the sums of `distance_sums` over `total_k`, by one search.

    Neither `k` nor `total_k` counts the point itself.
    """
    most, tree = max(k, total_k), tree_of(xyz, mask, None, None)
    points = tree.points()
    if tree.tree is None:
        found = nearest_in(tree, points, None, k=most, include_self=False)
        neighbors, (total, count) = found.neighbors[:, :k], _sums(found.sq_dist[:, :total_k])
    else:

        def finish(ranked: Ranked) -> tuple[Array, ...]:
            return rows_in_order(ranked, k), *distance_sum(ranked, total_k)

        neighbors, total, count = _own_neighbors(tree, points, most, finish)
    usable, odd = points.usable(), points.status()
    neighbors = jnp.where(usable[:, None], neighbors, -1)
    total, count = jnp.where(usable, total, 0.0), jnp.where(usable, count, 0)
    few, few_summed = usable & (neighbors[:, -1] < 0), usable & (count < total_k)
    status, total_status = (odd | bit(each, Status.TOO_FEW_NEIGHBORS) for each in (few, few_summed))
    return ListAndSums(neighbors, status, total, count, total_status)


def knn_features(features: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None) -> KnnResult:
    """The k nearest rows of each row of a small feature matrix, all pairs compared; results and errors as `knn`.

    Args:
        features: Features `[n, c]`.
        k: Neighbours per row, the row itself not counted. Static.
        mask: True where a row counts `[n]`; all if None.
    """
    return knn(features, k=k, mask=mask)


def _sums(sq_dist: Float[Array, "n k"]) -> tuple[Float[Array, " n"], Int[Array, " n"]]:
    """Sums of distances, and how many there are."""
    near = jnp.isfinite(sq_dist)
    return jnp.sqrt(jnp.where(near, sq_dist, 0.0)).sum(axis=1), near.sum(axis=1, dtype=jnp.int32)


def _own_neighbors(tree: SearchTree, points: Points, k: int, finish: Finish) -> tuple[Array, ...]:
    """What `finish` makes of the neighbours of every point."""
    assert tree.tree is not None
    return by_tree(tree.tree, tree.tree, points.xyz.shape[0], k=k, include_self=False, finish=finish)
