"""Neighbours among few points: all pairs are measured, and the nearest chosen by a threshold instead of a sort."""

from functools import lru_cache, partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.cloud_by_cloud import cloud_by_cloud
from cablejax.ops.neighbors.brute import knn_brute, map_blocks, square_distances
from cablejax.ops.neighbors.kth import kth_smallest
from cablejax.ops.neighbors.select import INFINITE, WORD, columns, in_pieces

GROUPS = 128
COARSE = 13  # low bits of a threshold that are not searched: it lies up to 0.1 % too high and selects a few more
SPARE = 12  # places for keys beyond the k-th that the threshold lets through
BLOCK = 1 << 20  # pairs measured at once: their keys stay in the cache
FEW_CHANNELS = 8  # up to here differences cost less than a matrix product and a second measurement
ROUNDING = 2.0**-22  # four roundings per channel: of the product and the norms, for the k-th key and for the candidate


def knn_dense(
    queries: Float[Array, "q c"],
    xyz: Float[Array, "n c"],
    valid: Bool[Array, " n"],
    skip: Int[Array, " q"],
    *,
    k: int,
) -> tuple[Int[Array, "q k"], Float[Array, "q k"]]:
    """As `knn_brute`, without sorting on a CPU, and with a matrix product for the first look at many channels.

    The product's rounding moves no neighbour: candidates are taken up to its bound and measured again by differences.
    """
    if not chooses(xyz.shape[0], k):
        return knn_brute(queries, xyz, valid, skip, k=k)
    return _dense_of(k)(queries, xyz, valid, skip)


def chooses(n: int, k: int) -> bool:
    """Whether a choice by threshold pays: where there is something to leave out."""
    return n >= 2 * GROUPS and k <= GROUPS // 4


def choose(
    keys: Float[Array, "q n"], margin: float | Float[Array, " q"] = 0.0, *, k: int
) -> tuple[Int[Array, "q s"], Bool[Array, ""]]:
    """Columns of the k smallest keys of each row and of those up to `margin` above them, ascending, -1 for none.

    The columns are dealt into groups. The k-th smallest of the groups' least keys is a threshold that at least k keys
    do not exceed, and hardly more, as two of the k smallest seldom share a group.

    Returns:
        Columns, and whether all of them found room in every row; tens of equal keys do not.
    """
    rows, n = keys.shape
    bits = _bits(keys)
    padded = jnp.pad(bits, ((0, 0), (0, -n % GROUPS)), constant_values=INFINITE)
    least = jnp.min(padded.reshape(rows, -1, GROUPS), axis=1)
    threshold = kth_smallest(least, k - 1, coarse=COARSE) | ((1 << COARSE) - 1)
    value = lax.bitcast_convert_type(jnp.minimum(threshold, INFINITE - 1), jnp.float32) + margin
    hit = (padded <= jnp.minimum(_bits(value), INFINITE - 1)[:, None]).reshape(rows, -1, WORD).astype(jnp.uint32)
    words = jnp.sum(hit << jnp.arange(WORD, dtype=jnp.uint32)[None, None, :], axis=2)
    most = jnp.max(jnp.sum(lax.population_count(words), axis=1))
    slots = k + SPARE
    # The barrier keeps the choice out of a caller's branch, which would fuse all anew.
    column, fits = lax.optimization_barrier((columns(words, slots), (most <= slots) & jnp.isfinite(value).all()))
    return column, fits


def in_order(row: Int[Array, "q s"], key: Float[Array, "q s"], *, k: int, ascending: bool = False) -> Int[Array, "q k"]:
    """Places `[0, s)` of the k smallest keys by key, then row; -1 marks none in `row` and in what is returned.

    Rows that are known to ascend (static) save a comparison.
    """
    bits, slots = jnp.where(row >= 0, _bits(key), INFINITE), row.shape[1]
    order = jnp.arange(slots, dtype=jnp.int32)[None, :] if ascending else row

    def before(part: slice) -> Array:
        lower_row = (order[:, None, part] < order[:, :, None]).astype(jnp.int32)
        # a <= b is a < b + 1: one comparison for both orders, as no key is the largest integer.
        return jnp.sum((bits[:, None, part] < bits[:, :, None] + lower_row).astype(jnp.int32), axis=2)

    rank = in_pieces(before, slots)

    def placed(part: slice) -> Array:
        holds = (rank[:, None, part] == jnp.arange(k, dtype=jnp.int32)[None, :, None]) & (row >= 0)[:, None, part]
        return jnp.sum(jnp.where(holds, jnp.arange(1, slots + 1, dtype=jnp.int32)[None, None, part], 0), axis=2)

    return in_pieces(placed, slots) - 1


@lru_cache
def _dense_of(k: int):
    return cloud_by_cloud(partial(_dense, k=k))


def _dense(queries: Array, xyz: Array, valid: Array, skip: Array, *, k: int) -> tuple[Array, Array]:
    def by_threshold(queries: Array, xyz: Array, valid: Array, skip: Array) -> tuple[Array, Array]:
        # Shuffled, or the lines of a scan would put neighbours into one group, where the threshold lets too many through.
        row = jnp.asarray(np.random.default_rng(0).permutation(xyz.shape[0]), dtype=jnp.int32)
        points, (n, m) = _Points(xyz[row], valid[row], row), (queries.shape[0], xyz.shape[0])
        return map_blocks(partial(_nearest, points, k=k), n, m, queries, skip, elements=BLOCK)

    return lax.platform_dependent(queries, xyz, valid, skip, cpu=by_threshold, default=partial(knn_brute, k=k))


class _Points(NamedTuple):
    """Points in shuffled order, with their rows."""

    xyz: Float[Array, "n c"]
    valid: Bool[Array, " n"]
    row: Int[Array, " n"]


def _nearest(points: _Points, queries: Array, skip: Array, *, k: int) -> tuple[Array, Array]:
    few = queries.shape[1] <= FEW_CHANNELS
    measured, margin = (square_distances(queries, points.xyz), 0.0) if few else _by_product(queries, points)
    keys = jnp.where(points.valid[None, :] & (points.row[None, :] != skip[:, None]), measured, jnp.inf)
    column, fits = choose(keys, margin, k=k)

    def chosen() -> tuple[Array, Array]:
        at = jnp.maximum(column, 0)
        if few:
            key = jnp.take_along_axis(keys, at, axis=1, mode="promise_in_bounds")
        else:
            key = jnp.sum(jnp.square(queries[:, None, :] - points.xyz.at[at].get(mode="promise_in_bounds")), axis=-1)
        row = jnp.where(column >= 0, points.row[at], -1)
        place = in_order(row, key, k=k)
        found, slot = place >= 0, jnp.maximum(place, 0)
        row, sq_dist = (jnp.take_along_axis(a, slot, axis=1, mode="promise_in_bounds") for a in (row, key))
        return jnp.where(found, row, -1), jnp.where(found, sq_dist, jnp.inf)

    def sorted_keys() -> tuple[Array, Array]:
        back = jnp.argsort(points.row)
        return knn_brute(queries, points.xyz[back], points.valid[back], skip, k=k)

    return lax.cond(fits, chosen, sorted_keys)


def _by_product(queries: Array, points: _Points) -> tuple[Float[Array, "q n"], Float[Array, " q"]]:
    """Squared distances by a matrix product, and how far the order of two of them may be wrong for each query."""
    xyz, valid = points.xyz, points.valid
    centre = jnp.sum(jnp.where(valid[:, None], xyz, 0.0), axis=0)[None, :] / jnp.maximum(jnp.sum(valid), 1)
    queries, xyz = queries - centre, jnp.where(valid[:, None], xyz - centre, 0.0)
    own, norm = jnp.sum(jnp.square(queries), axis=1), jnp.sum(jnp.square(xyz), axis=1)
    product = jnp.matmul(queries, xyz.T, precision=lax.Precision.HIGHEST)
    sq_dist = jnp.maximum(own[:, None] - 2.0 * product + norm[None, :], 0.0)
    return sq_dist, ROUNDING * xyz.shape[1] * (own + jnp.max(norm))


def _bits(keys: Float[Array, "..."]) -> Int[Array, "..."]:
    """Integers that sort as the keys do, if at most one of them is negative."""
    return lax.bitcast_convert_type(keys, jnp.int32)
