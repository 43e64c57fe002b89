"""Choose and rank the candidates of blocks of queries that share their leaves."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

from cablejax.ops.neighbors.metric import square_length
from cablejax.ops.neighbors.select import INFINITE, LARGEST, WORD, apart, columns, in_pieces, narrow, selected
from cablejax.ops.neighbors.tree import LEAF, Tree

SMALLEST = 0x00800000  # bits of the smallest float that no processor takes for zero


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

    def last(self, k: int) -> Float[Array, " q"]:
        """Squared distance of the k-th candidate, inf where there are fewer."""
        return jnp.min(jnp.where(self.rank == k - 1, self.sq_dist, jnp.inf), axis=1)


class Candidates(NamedTuple):
    """What b blocks of 8 queries choose from: the points of leaves that a block shares, then what each query had found.

    Attributes:
        row: Rows of the shared points in the cloud `[b, shared]`, -1 where there is none.
        found: Rows found before, of no leaf of these `[b, 8, before]`, -1 where there is none.
        sq_dist: Squared distances of the shared points, 32 to a word `[b, 8, words, 32]`; inf where there is no point, and
            to the query itself.
        found_sq_dist: Squared distances of those found before `[b, 8, more words, 32]`; inf where there is none.
    """

    row: Int[Array, "b shared"]
    found: Int[Array, "b 8 before"]
    sq_dist: Float[Array, "b 8 words 32"]
    found_sq_dist: Float[Array, "b 8 more 32"]

    def words(self) -> int:
        """Words of scores."""
        return self.sq_dist.shape[2] + self.found_sq_dist.shape[2]

    def word(self, number: int) -> Float[Array, "b 8 32"]:
        """One word of scores."""
        shared = self.sq_dist.shape[2]
        return self.sq_dist[:, :, number, :] if number < shared else self.found_sq_dist[:, :, number - shared, :]

    def selected(self, threshold: Float[Array, "b 8"]) -> UInt[Array, "b 8 all"]:
        """One bit per score, set where score <= threshold."""
        return jnp.concatenate([selected(each, threshold) for each in (self.sq_dist, self.found_sq_dist)], axis=2)


def slots_for(k: int) -> int:
    """Candidates ranked for k neighbours: room for the point itself, near ties, and a quick threshold."""
    return -(-(k + 8 + k // 8) // 4) * 4


def gather(
    tree: Tree,
    leaf: Int[Array, "b m"],
    before_row: Int[Array, "q s"],
    before_sq_dist: Float[Array, "q s"],
    xyz: Float[Array, "a b 8"],
    own_row: Int[Array, "b 8"],
    sure: Bool[Array, ""],
) -> Candidates:
    """Measure the points of each block's leaves, -1 for none, and put them beside what its queries found before.

    Distances are measured once and kept: measured anew in another kernel they could differ in the last bit.
    """
    blocks = leaf.shape[0]
    spare = -(leaf.shape[1] * LEAF) % WORD

    def read(leaf: Array, tree_row: Array, tree_xyz: Array) -> tuple[Array, Array]:
        at = jnp.maximum(leaf, 0)
        row = jnp.where((leaf >= 0)[:, :, None], tree_row[at], -1).reshape(blocks, -1)
        row = jnp.pad(row, ((0, 0), (0, spare)), constant_values=-1)
        there = jnp.pad(tree_xyz[:, at].reshape(len(tree_xyz), blocks, -1), ((0, 0), (0, 0), (0, spare)))
        return row, jnp.where((row >= 0)[None], there, jnp.inf)

    row, points = apart(read, sure, leaf, tree.row, tree.xyz)

    def measure(xyz: Array, own_row: Array, row: Array, points: Array) -> Array:
        sq_dist = square_length(xyz[:, :, :, None] - points[:, :, None, :], tree.box)
        sq_dist = jnp.where(row[:, None, :] != own_row[:, :, None], sq_dist, jnp.inf)
        return sq_dist.reshape(blocks, LEAF, -1, WORD)

    sq_dist = apart(measure, sure, xyz, own_row, row, points)
    old = jnp.pad(before_sq_dist, ((0, 0), (0, -before_sq_dist.shape[1] % WORD)), constant_values=jnp.inf)
    old = old.reshape(blocks, LEAF, -1, WORD)
    return Candidates(row, before_row.reshape(blocks, LEAF, -1), sq_dist, old)


def choose(
    candidates: Candidates,
    guess: Float[Array, "b 8"],
    *,
    k: int,
    active: Bool[Array, "b 8"],
    patience: Int[Array, ""],
    sure: Bool[Array, ""],
) -> tuple[Ranked, Float[Array, " q"], Bool[Array, "b 8"]]:
    """Rank the nearest candidates of each query.

    Args:
        candidates: What to choose from.
        guess: Squared distance at which about k points are expected, above zero `[b, 8]`.
        k: Neighbours wanted. Static.
        active: Queries that matter.
        patience: So many queries may get no answer where that would take longer than for the others.
        sure: A condition that holds, see `apart`.

    Returns:
        The ranked candidates, the k nearest of each query among them; the squared distance of the k-th `[q]`, LARGEST if
        there are fewer; and who got an answer.
    """
    (blocks, q, shared_words, _), words = candidates.sq_dist.shape, candidates.words()
    slots = min(slots_for(k), words * WORD)
    least = min(k, slots)
    found = narrow(
        lambda candidates, word: candidates.word(word),
        candidates,
        words=words,
        least=least,
        most=slots,
        guess=guess,
        active=active,
        patience=patience,
    )

    def ties_by_row() -> Array:
        """Bits of the candidates below a tie, and of as many of the tie as are wanted, the lowest rows."""
        tie = found.above[..., None, None]
        spare = ((0, 0), (0, 0), (0, -candidates.found.shape[2] % WORD))
        before = jnp.pad(candidates.found, spare, constant_values=-1).reshape(candidates.found_sq_dist.shape)
        row = jnp.broadcast_to(candidates.row.reshape(blocks, 1, -1, WORD), candidates.sq_dist.shape)
        row = jnp.concatenate([row, before], axis=2)
        sq_dist = jnp.concatenate([candidates.sq_dist, candidates.found_sq_dist], axis=2)
        order = jnp.where(sq_dist < tie, 0, jnp.where(sq_dist == tie, row + SMALLEST, INFINITE))
        by_row, some = lax.bitcast_convert_type(order, jnp.float32), jnp.ones_like(guess)
        chosen = narrow(_word, by_row, words=words, least=least, most=slots, guess=some, active=found.tied)
        return jnp.where(found.tied[..., None], selected(by_row, chosen.value), candidates.selected(found.value))

    bits = lax.cond(jnp.any(found.tied), ties_by_row, lambda: candidates.selected(found.value))
    column = apart(lambda bits: columns(bits, slots), sure, bits)

    def pick(column: Array, candidates: Candidates) -> tuple[Array, Array]:
        at, shared, more = jnp.maximum(column, 0), candidates.row.shape[1], candidates.found.shape[2]
        block = jnp.arange(blocks, dtype=jnp.int32)[:, None, None]
        lane = block * q + jnp.arange(q, dtype=jnp.int32)[None, :, None]
        new_at, old_at = jnp.minimum(at, shared - 1), jnp.clip(at - shared, 0, more - 1)
        new_row, new = _read(candidates.row, block * shared + new_at), _read(candidates.sq_dist, lane * shared + new_at)
        old_row = _read(candidates.found, lane * more + old_at)
        old = _read(candidates.found_sq_dist, lane * (words - shared_words) * WORD + old_at)
        row, sq_dist = jnp.where(at < shared, new_row, old_row), jnp.where(at < shared, new, old)
        real = (column >= 0) & (sq_dist < jnp.inf)
        return (
            jnp.where(real, row, -1).reshape(-1, slots),
            jnp.where(real, sq_dist, jnp.inf).reshape(-1, slots),
        )

    ranked = apart(rank, sure, *apart(pick, sure, column, candidates))
    return ranked, jnp.minimum(ranked.last(k), LARGEST), found.complete | found.tied


def _read(array: Array, place: Int[Array, "..."]) -> Array:
    """Entries of the flattened array, all in bounds."""
    return array.reshape(-1).at[place].get(mode="promise_in_bounds")


def _word(scores: Float[Array, "... w 32"], word: int) -> Float[Array, "... 32"]:
    """One word of scores."""
    return scores[..., word, :]


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
    every = jnp.broadcast_to(jnp.arange(there.shape[1], dtype=jnp.int32), there.shape)
    slot = jnp.maximum(_put_in_order(ranked, every, k), 0)
    found = jnp.arange(k, dtype=jnp.int32)[None, :] < jnp.sum(there, axis=1, dtype=jnp.int32)[:, None]
    place = jnp.arange(slot.shape[0], dtype=jnp.int32)[:, None] * there.shape[1] + slot
    row, sq_dist = (a.reshape(-1).at[place].get(mode="promise_in_bounds") for a in (ranked.row, ranked.sq_dist))
    return jnp.where(found, row, -1), jnp.where(found, sq_dist, jnp.inf)


def rows_in_order(ranked: Ranked, k: int) -> Int[Array, "q k"]:
    """The rows of `in_order` alone."""
    return _put_in_order(ranked, ranked.row, k)


def _put_in_order(ranked: Ranked, value: Int[Array, "q s"], k: int) -> Int[Array, "q k"]:
    """The values, none of them negative, of the k first candidates in order; -1 where there are fewer."""

    def placed(part: slice) -> Array:
        hit = ranked.rank[:, None, part] == jnp.arange(k, dtype=jnp.int32)[None, :, None]
        return jnp.sum(
            jnp.where(hit & (ranked.row[:, None, part] >= 0), value[:, None, part] + 1, 0), axis=2, dtype=jnp.int32
        )

    return in_pieces(placed, ranked.row.shape[1]) - 1


def distance_sum(ranked: Ranked, k: int) -> tuple[Float[Array, " q"], Int[Array, " q"]]:
    """Sum of the k smallest distances of each query, and how many there are."""
    near = (ranked.rank < k) & (ranked.row >= 0)
    return jnp.sqrt(jnp.where(near, ranked.sq_dist, 0.0)).sum(axis=1), near.sum(axis=1, dtype=jnp.int32)
