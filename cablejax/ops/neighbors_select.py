"""Select the smallest of many scores per row without sorting: find a threshold by histograms, then read the winners' bits.

Sorting and top-k are slow on a CPU and resist vectors; a histogram is one fused pass. Floats above zero lie in the order of
their bits, so the bins are bits: eight bins of half an octave around a guess settle most rows at once, and what they leave
open is cut in eight again. Scores come as `[..., w, 32]`, 32 to a word.
"""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

WORD = 32
LARGEST = float(jnp.finfo(jnp.float32).max)
BINS = 8
HALF_OCTAVE = 22  # a float's bits above this place step by half an octave
INFINITE = 0x7F800000  # bits of infinity: no score of a candidate lies as high
FULL = 15  # words that a bin of four bits can count
ROUNDS = 10  # eight bins cut the 31 bits of a float above zero down to one in ten rounds


class Threshold(NamedTuple):
    """A threshold per row.

    Attributes:
        value: Scores <= value are selected `[...]`.
        complete: True where no more than `most` are, so that all of them find room `[...]`.
    """

    value: Float[Array, "..."]
    complete: Bool[Array, "..."]


class _Search(NamedTuple):
    """Brackets `[...]` in float-bit order: fewer than `least` scores lie below `low`, more than `most` below `high`."""

    step: Int[Array, ""]
    settled: Bool[Array, "..."]
    edge: Int[Array, "..."]
    low: Int[Array, "..."]
    high: Int[Array, "..."]
    start: Int[Array, "..."]
    shift: Int[Array, "..."]
    counts: UInt[Array, "... g 32"]


def narrow(
    score: Callable[[Any, int], Array],
    operands: Any,
    *,
    words: int,
    least: int,
    most: int,
    guess: Float[Array, "..."],
    active: Bool[Array, "..."],
) -> Threshold:
    """Find thresholds that select between `least` and `most` scores of each row, or all if there are no more than `most`.

    Args:
        score: The scores `[..., 32]` of one word as a function of `operands` and the word's number; inf for none.
        operands: What `score` is made from.
        words: Number of words. Static.
        least: Smallest count wanted. Static.
        most: Largest count accepted. Static.
        guess: Where to look first, above zero `[...]`.
        active: Rows that matter `[...]`; others never keep the loop going.

    Returns:
        Thresholds; where ties leave none, one that selects too few. A few rows in a hundred may go without one that a
        longer search would find.
    """
    rows = max(1, guess.size)

    def measure(start: Array, shift: Array) -> Array:
        return _histogram(lambda word: score(operands, word), words, start, shift)

    def unsettled(search: _Search) -> Array:
        return (search.step < ROUNDS) & (jnp.sum(~search.settled) > rows // 64)

    def once(search: _Search) -> _Search:
        now = _settle(search, least, most)
        # Counts are carried from round to round: as a value of the loop they are one pass, read by several consumers.
        counts = lax.cond(unsettled(now), measure, lambda start, shift: search.counts, now.start, now.shift)
        return now._replace(counts=counts)

    middle = lax.bitcast_convert_type(jnp.minimum(guess, 1e37), jnp.int32)
    start = jnp.maximum(middle - ((BINS // 2) << HALF_OCTAVE), 0)
    none = jnp.zeros(guess.shape, dtype=jnp.int32)
    # The first round finds no counts and measures: so what the scores are made from reaches the loop as finished arrays.
    counts = jnp.zeros((*guess.shape, -(-words // FULL), WORD), dtype=jnp.uint32)
    first = _Search(jnp.int32(-1), ~active, none, none, none + INFINITE, start, none + HALF_OCTAVE, counts)
    last = lax.while_loop(unsettled, once, first)
    edge = jnp.where(last.settled, last.edge, last.low)
    return Threshold(lax.bitcast_convert_type(jnp.maximum(edge - 1, 0), jnp.float32), edge > 0)


def apart(function: Callable[..., Any], sure: Bool[Array, ""], *operands: Any) -> Any:
    """What `function` makes of finished arrays, as finished arrays.

    XLA would fuse a gather or a bit search into each of its consumers and do it again for every pair of candidates. It does
    not look into the branches of a condition, so `sure` is one that always holds but that XLA cannot know to hold.
    """

    def never(*operands: Any) -> Any:
        return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(function, *operands))

    return lax.cond(sure, function, never, *operands)


def in_pieces(count: Callable[[slice], Array], size: int) -> Array:
    """The sum of what `count` makes of up to 32 columns at a time.

    XLA's loops over more are not vectorised on a CPU where rows are compared with each other, and take 30 times as long:
    ranking 120 columns of 8,192 rows takes 134 ms at once and 4 ms in pieces.
    """
    return reduce(add, (count(slice(first, min(first + WORD, size))) for first in range(0, size, WORD)))


def selected(score: Float[Array, "... w 32"], threshold: Float[Array, "..."]) -> UInt[Array, "... w"]:
    """One bit per score, set where score <= threshold."""
    hit = (score <= threshold[..., None, None]).astype(jnp.uint32)
    return jnp.sum(hit << _ramp(score.ndim, WORD, jnp.uint32), axis=-1)


def columns(words: UInt[Array, "... w"], m: int) -> Int[Array, "... m"]:
    """Column numbers of the first `m` set bits of each row, ascending; -1 where there are fewer."""
    ndim, w = words.ndim, words.shape[-1]
    count = lax.population_count(words).astype(jnp.int32)
    earlier = (jnp.arange(w)[:, None] > jnp.arange(w)[None, :]).reshape((1,) * (ndim - 1) + (w, w))
    start = jnp.sum(jnp.where(earlier, count[..., None, :], 0), axis=-1)
    end = start + count
    nth = _ramp(ndim, m)
    holds = (start[..., None, :] <= nth[..., None]) & (nth[..., None] < end[..., None, :])
    word = jnp.sum(jnp.where(holds, words[..., None, :], 0), axis=-1, dtype=jnp.uint32)
    rank = nth - jnp.sum(jnp.where(holds, start[..., None, :], 0), axis=-1)
    column = WORD * jnp.sum(jnp.where(holds, _ramp(ndim + 1, w), 0), axis=-1)
    for half in (16, 8, 4, 2, 1):
        low = word & jnp.uint32((1 << half) - 1)
        skipped = lax.population_count(low).astype(jnp.int32)
        upper = rank >= skipped
        word = jnp.where(upper, word >> half, low)
        rank = jnp.where(upper, rank - skipped, rank)
        column = jnp.where(upper, column + half, column)
    return jnp.where(nth < end[..., -1:], column, -1)


def _histogram(score: Callable[[int], Array], words: int, start: Int[Array, "..."], shift: Int[Array, "..."]) -> Array:
    """Counts by column over up to 15 words each `[..., g, 32]`, in eight bins of four bits; the first bin holds all below."""
    sums = []
    for first in range(0, words, FULL):
        total = jnp.uint32(0)
        for word in range(first, min(first + FULL, words)):
            bits = lax.bitcast_convert_type(score(word), jnp.int32)
            place = jnp.clip((bits - start[..., None]) >> shift[..., None], 0, BINS - 1)
            one = (bits < INFINITE).astype(jnp.uint32)
            total = total + (one << (4 * place).astype(jnp.uint32))
        sums.append(total)
    return jnp.stack(sums, axis=-2)


def _settle(search: _Search, least: int, most: int) -> _Search:
    """Read the histogram: settle rows with a good edge, tighten the brackets of the others, and place their next bins."""
    low_half = jnp.uint32(0x000F000F)
    pairs = [jnp.sum((search.counts >> (4 * i)) & low_half, axis=(-2, -1), dtype=jnp.uint32) for i in range(4)]
    bins = [pair & 0xFFFF for pair in pairs] + [pair >> 16 for pair in pairs]
    settled, edge, low, high = search.settled, search.edge, search.low, search.high
    below = jnp.zeros(settled.shape, dtype=jnp.int32)
    for i in range(BINS):
        below = below + bins[i].astype(jnp.int32)
        end = search.start.astype(jnp.uint32) + (jnp.uint32(i + 1) << search.shift.astype(jnp.uint32))
        end = jnp.minimum(end, INFINITE).astype(jnp.int32) if i < BINS - 1 else jnp.full(below.shape, INFINITE)
        fits = (below <= most) & ((below >= least) if i < BINS - 1 else True)
        edge = jnp.where(fits & ~settled, end, edge)
        settled = settled | fits
        low = jnp.where(below < least, jnp.maximum(low, end), low)
        high = jnp.where(below > most, jnp.minimum(high, end), high)
    width = jnp.maximum(high - low - 1, 1)
    shift = jnp.maximum(32 - lax.clz(width) - 3, 0)
    stuck = high - low <= 1
    now = _Search(
        search.step + 1, settled | stuck, jnp.where(stuck & ~settled, low, edge), low, high, low, shift, search.counts
    )
    return jax.tree.map(lambda new, old: jnp.where(search.step < 0, old, new), now, search)._replace(
        step=search.step + 1
    )


def _ramp(ndim: int, size: int, dtype=jnp.int32) -> Array:
    """0, 1, ... along the last of `ndim` axes."""
    return jnp.arange(size, dtype=dtype).reshape((1,) * (ndim - 1) + (size,))
