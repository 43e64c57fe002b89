"""Measure and rank the candidates of blocks of queries, and say which rows are proven."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors_descent import Near
from cablejax.ops.neighbors_select import LARGEST, WORD, apart, columns, in_pieces, narrow, selected
from cablejax.ops.neighbors_tree import LEAF, Tree

SURE = 1.0 - 1e-6  # below this share of a bound, rounding of a squared distance measured in two ways does not matter


class Ranked(NamedTuple):
    """Candidates of each query, unordered, with their rank.

    Attributes:
        row: Row of each candidate in the cloud `[q, s]` int32, -1 where there is none.
        sq_dist: Squared distance `[q, s]`, inf where there is none.
        rank: Place in the order by distance, then row `[q, s]` int32; unique among candidates.
    """

    row: Int[Array, "q s"]
    sq_dist: Float[Array, "q s"]
    rank: Int[Array, "q s"]


class Verdict(NamedTuple):
    """What is known about each query.

    Attributes:
        proven: True where the k nearest of all points are among the candidates `[q]`.
        reach: Squared distance within which k neighbours are known `[q]`; LARGEST where fewer are.
    """

    proven: Bool[Array, " q"]
    reach: Float[Array, " q"]


def slots_for(k: int) -> int:
    """Candidates ranked for k neighbours: room for the point itself, near ties, and a quick threshold."""
    return -(-(k + 8 + k // 8) // 4) * 4


def rank_blocks(
    tree: Tree,
    xyz: Float[Array, "3 b q"],
    own_row: Int[Array, "b q"],
    near: Near,
    guess: Float[Array, "b q"],
    *,
    k: int,
) -> tuple[Ranked, Verdict]:
    """Rank the candidates of b blocks of q queries that share their leaves.

    Args:
        tree: The points searched.
        xyz: Queries `[3, b, q]`.
        own_row: Row that a query must not find `[b, q]`, -1 for none, -2 where there is no query.
        near: Leaves of each block, a multiple of four.
        guess: Squared distance at which about k points are expected `[b, q]`.
        k: Neighbours wanted. Static.

    Returns:
        Ranked candidates and verdicts, one row per query.
    """
    blocks, q = own_row.shape
    slots = min(slots_for(k), near.node.shape[1] * LEAF)
    leaf = jnp.maximum(near.node, 0)
    sure = near.bound.min() >= 0.0

    def gather(node: Array, leaf: Array, tree_row: Array, tree_xyz: Array) -> Array:
        there = (tree_row[leaf] >= 0) & (node >= 0)[:, :, None]
        return jnp.where(there[None], tree_xyz[:, leaf], jnp.inf).reshape(3, blocks, 1, -1, WORD)

    candidates = apart(gather, sure, near.node, leaf, tree.row, tree.xyz)
    words = candidates.shape[3]

    def score(operands: tuple[Array, Array], word: int) -> Array:
        return _square_sum(operands[0][:, :, :, None] - operands[1][:, :, :, word, :])

    least = min(k + 1, words * WORD)
    operands = (xyz, candidates)
    found = narrow(score, operands, words=words, least=least, most=slots, guess=guess, active=own_row > -2)
    words = selected(_square_sum(xyz[:, :, :, None, None] - candidates), found.value)
    column = apart(lambda words: columns(words, slots), sure, words)

    def pick(column: Array, candidates: Array) -> tuple[Array, Array]:
        at = jnp.maximum(column, 0)
        other = _rows(tree, leaf, at)
        place = jnp.arange(blocks)[:, None, None] * candidates[0, 0].size + at
        there = [axis.reshape(-1).at[place].get(mode="promise_in_bounds") for axis in candidates]
        sq_dist = _square_sum([own[:, :, None] - found for own, found in zip(xyz, there, strict=True)])
        real = (column >= 0) & (other != own_row[:, :, None])
        return jnp.where(real, other, -1).reshape(-1, slots), jnp.where(real, sq_dist, jnp.inf).reshape(-1, slots)

    ranked = apart(rank, sure, *apart(pick, sure, column, candidates))
    last = jnp.min(jnp.where(ranked.rank == k - 1, ranked.sq_dist, jnp.inf), axis=1)
    value, complete = found.value.reshape(-1), found.complete.reshape(-1)
    bound = jnp.repeat(near.bound, q)
    inside = complete & ((last <= value * SURE) | (value >= LARGEST))
    proven = inside & ((last < bound * SURE) | (bound >= LARGEST))
    return ranked, Verdict(proven | (own_row.reshape(-1) == -2), jnp.minimum(last, LARGEST))


def rank(row: Int[Array, "q s"], sq_dist: Float[Array, "q s"]) -> Ranked:
    """Order candidates by distance, then row, by counting those that come before; faster than sorting short rows."""
    bits = lax.bitcast_convert_type(sq_dist, jnp.int32)  # in the order of the floats, as none of them is negative

    def before(part: slice) -> Array:
        lower_row = (row[:, None, part] < row[:, :, None]).astype(jnp.int32)
        return jnp.sum((bits[:, None, part] - bits[:, :, None] - lower_row) < 0, axis=2, dtype=jnp.int32)

    return Ranked(row, sq_dist, in_pieces(before, row.shape[1]))


def in_order(ranked: Ranked, k: int) -> tuple[Int[Array, "q k"], Float[Array, "q k"]]:
    """The k first candidates in order: rows, -1 where there are fewer, and squared distances, inf there."""
    there = ranked.row >= 0
    slot = jnp.maximum(_put_in_order(ranked, jnp.broadcast_to(jnp.arange(there.shape[1]), there.shape), k), 0)
    found = jnp.arange(k)[None, :] < jnp.sum(there, axis=1)[:, None]
    owner = jnp.arange(slot.shape[0])[:, None]
    row, sq_dist = (array.at[owner, slot].get(mode="promise_in_bounds") for array in (ranked.row, ranked.sq_dist))
    return jnp.where(found, row, -1), jnp.where(found, sq_dist, jnp.inf)


def rows_in_order(ranked: Ranked, k: int) -> Int[Array, "q k"]:
    """The rows of `in_order` alone."""
    return _put_in_order(ranked, ranked.row, k)


def _put_in_order(ranked: Ranked, value: Int[Array, "q s"], k: int) -> Int[Array, "q k"]:
    """The values, none of them negative, of the k first candidates in order; -1 where there are fewer."""

    def placed(part: slice) -> Array:
        hit = ranked.rank[:, None, part] == jnp.arange(k)[None, :, None]
        return jnp.sum(jnp.where(hit & (ranked.row[:, None, part] >= 0), value[:, None, part] + 1, 0), axis=2)

    return in_pieces(placed, ranked.row.shape[1]) - 1


def distance_sum(ranked: Ranked, k: int) -> tuple[Float[Array, " q"], Int[Array, " q"]]:
    """Sum of the k smallest distances of each query, and how many there are."""
    near = (ranked.rank < k) & (ranked.row >= 0)
    return jnp.sqrt(jnp.where(near, ranked.sq_dist, 0.0)).sum(axis=1), near.sum(axis=1, dtype=jnp.int32)


def _rows(tree: Tree, leaf: Int[Array, "b m"], column: Int[Array, "b q s"]) -> Int[Array, "b q s"]:
    """Rows in the cloud of the candidates in given columns of their block."""
    first = jnp.arange(leaf.shape[0])[:, None, None] * leaf.shape[1]
    owner = leaf.reshape(-1).at[first + column // LEAF].get(mode="promise_in_bounds")
    return tree.row.reshape(-1).at[owner * LEAF + column % LEAF].get(mode="promise_in_bounds")


def _square_sum(difference: Float[Array, "3 ..."] | list[Array]) -> Float[Array, "..."]:
    """Squared length, summed in the order x, y, z."""
    return jnp.square(difference[0]) + jnp.square(difference[1]) + jnp.square(difference[2])
