"""The dynamic neighbour graph of a network: exact nearest rows in feature space, all pairs measured."""

from functools import lru_cache, partial

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.cloud_by_cloud import cloud_by_cloud
from cablejax.ops.neighbors.dense import choose, chooses, in_order

SELF = -1.0  # before every distance; as bits it is the one negative number


def feature_graph(features: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None) -> Int[Array, "n k"]:
    """The k nearest points of each point in feature space, itself first, as in DGCNN's dynamic graph.

    All pairs are measured, which suits the few thousand points a network sees; for scans use `cablejax.ops.knn`. Three
    channels are measured by differences; more by a matrix product of the centred features, whose rounding (about 1e-6
    of the largest squared norm) may swap neighbours that are equally far to within it.

    Args:
        features: Coordinates or features `[n, c]`.
        k: Neighbours per point, the point itself counted. Static.
        mask: True where a row is a point `[n]`; None means all.

    Returns:
        Row numbers `[n, k]` int32 by increasing distance, ties by index; -1 where there are fewer than k valid points,
        and throughout the rows of padding.

    Raises:
        ValueError: If `k` is below 1 or above n.

    Example:
        >>> feature_graph(jnp.array([[0.0], [1.0], [3.0]]), k=2).tolist()
        [[0, 1], [1, 0], [2, 1]]
    """
    n = features.shape[0]
    if not 1 <= k <= n:
        raise ValueError(f"k: expected 1 to n = {n}, got {k}")
    mask = jnp.ones(n, dtype=bool) if mask is None else mask
    return _graph_of(k)(lax.stop_gradient(features), mask)


@lru_cache
def _graph_of(k: int):
    return cloud_by_cloud(partial(_graph, k=k))


def _graph(features: Float[Array, "n c"], mask: Bool[Array, " n"], *, k: int) -> Int[Array, "n k"]:
    keys = distance_keys(features, mask)
    if not chooses(features.shape[0], k):
        neighbors = _smallest_by_top_k(keys, k=k)
    else:  # the choice by threshold is written for the CPU's vectors
        by_top_k = partial(_smallest_by_top_k, k=k)
        neighbors = lax.platform_dependent(keys, cpu=partial(_smallest_by_threshold, k=k), default=by_top_k)
    return jnp.where(mask[:, None], neighbors, -1)


def distance_keys(features: Float[Array, "n c"], mask: Bool[Array, " n"]) -> Float[Array, "n n"]:
    """Squared distances, `SELF` for a point itself and infinity for padding.

    A row that is not finite has itself alone for a neighbour.
    """
    n, channels = features.shape
    features = jnp.where(mask[:, None], features, 0.0)
    if channels == 3:
        sq_dist = jnp.sum((features[:, None, :] - features[None, :, :]) ** 2, axis=-1)
    else:
        centred = features - (jnp.sum(features, axis=0) / jnp.maximum(jnp.sum(mask, dtype=features.dtype), 1))[None, :]
        sq_norm = jnp.sum(centred**2, axis=-1)
        product = jnp.matmul(centred, centred.T, precision=lax.Precision.HIGHEST)
        sq_dist = jnp.maximum(sq_norm[:, None] - 2.0 * product + sq_norm[None, :], 0.0)
    keys = jnp.where(mask[None, :] & (sq_dist < jnp.inf), sq_dist.astype(jnp.float32), jnp.inf)
    return jnp.where(jnp.eye(n, dtype=bool), SELF, keys)


def _smallest_by_top_k(keys: Float[Array, "n n"], *, k: int) -> Int[Array, "n k"]:
    """Columns of the k smallest keys of each row in order; -1 for missing ones."""
    negative, column = lax.top_k(-keys, k)
    return jnp.where(negative > -jnp.inf, column, -1)


def _smallest_by_threshold(keys: Float[Array, "n n"], *, k: int) -> Int[Array, "n k"]:
    """As `_smallest_by_top_k`, without sorting rows; clouds with tens of equal points are left to top-k."""
    column, fits = choose(keys, k=k)

    def chosen() -> Int[Array, "n k"]:
        key = jnp.take_along_axis(keys, jnp.maximum(column, 0), axis=1, mode="promise_in_bounds")
        place = in_order(column, key, k=k, ascending=True)
        row = jnp.take_along_axis(column, jnp.maximum(place, 0), axis=1, mode="promise_in_bounds")
        return jnp.where(place >= 0, row, -1)

    return lax.cond(fits, chosen, lambda: _smallest_by_top_k(keys, k=k))
