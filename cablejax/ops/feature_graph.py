"""The dynamic neighbour graph of a network: exact nearest rows in feature space, all pairs measured."""

from functools import lru_cache, partial

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.cloud_by_cloud import cloud_by_cloud
from cablejax.ops.neighbors_select import WORD, columns

SELF = -1.0  # before every distance
MISSING = 0x7F800000  # the bits of infinity
GROUPS = 128
COARSE = 13  # low bits of a threshold that are not searched: it lies up to 0.1 % too high and selects a few more


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
    # The choice by threshold pays where there is something to leave out, and is written for the CPU's vectors.
    if features.shape[0] < 2 * GROUPS or k > GROUPS // 4:
        neighbors = _smallest_by_top_k(keys, k=k)
    else:
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
        centred = features - (jnp.sum(features, axis=0) / jnp.maximum(jnp.sum(mask), 1))[None, :]
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
    """As `_smallest_by_top_k`, without sorting rows.

    The columns are dealt into groups. The k-th smallest of the groups' least keys is a threshold that at least k keys
    do not exceed, and hardly more, as two of the k smallest seldom share a group. Those are ranked among each other. A
    cloud in which a row has too many of them (tens of equal points) is left to top-k.
    """
    n = keys.shape[0]
    bits = lax.bitcast_convert_type(keys, jnp.int32)  # sort as the floats do: the one negative number is alone
    padded = jnp.pad(bits, ((0, 0), (0, -n % GROUPS)), constant_values=MISSING)
    least = jnp.min(padded.reshape(n, -1, GROUPS), axis=1)
    threshold = jnp.minimum(_threshold(least, k), MISSING - 1)
    hit = (padded <= threshold[:, None]).reshape(n, -1, WORD).astype(jnp.uint32)
    words = jnp.sum(hit << jnp.arange(WORD, dtype=jnp.uint32)[None, None, :], axis=2)
    most = jnp.max(jnp.sum(lax.population_count(words), axis=1))
    slots = k + 12
    column = columns(words, slots)
    ranked = lax.optimization_barrier((column, most))  # keeps the choice out of the branch, which would fuse all anew
    return lax.cond(
        ranked[1] <= slots,
        lambda: _in_order(keys, ranked[0], k=k),
        lambda: _smallest_by_top_k(keys, k=k),
    )


def _threshold(values: Int[Array, "n g"], k: int) -> Int[Array, " n"]:
    """The k-th smallest value of each row, its low bits set, by fixing one bit after the other."""

    def fix(step: Array, found: Int[Array, " n"]) -> Int[Array, " n"]:
        trial = found | (1 << (30 - step))
        below = jnp.sum((values < trial[:, None]).astype(jnp.int32), axis=1)
        return jnp.where(below < k, trial, found)

    found = lax.fori_loop(0, 31 - COARSE, fix, jnp.zeros(values.shape[0], jnp.int32))
    return found | ((1 << COARSE) - 1)


def _in_order(keys: Float[Array, "n n"], column: Int[Array, "n s"], *, k: int) -> Int[Array, "n k"]:
    """Of the columns given in ascending order, -1 for none, the k with the smallest keys, by key, then column."""
    slots = column.shape[1]
    key = jnp.take_along_axis(keys, jnp.maximum(column, 0), axis=1, mode="promise_in_bounds")
    key = jnp.where(column >= 0, lax.bitcast_convert_type(key, jnp.int32), MISSING)
    earlier = (jnp.arange(slots)[None, :] < jnp.arange(slots)[:, None]).astype(jnp.int32)[None]
    # a <= b is a < b + 1: one comparison for both orders, as no key is the largest integer.
    before = key[:, None, :] < key[:, :, None] + earlier
    rank = jnp.sum(before.astype(jnp.int32), axis=2)
    place = rank[:, None, :] == jnp.arange(k)[None, :, None]
    return jnp.sum(jnp.where(place, column[:, None, :] + 1, 0), axis=2) - 1
