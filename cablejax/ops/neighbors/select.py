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
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

from cablejax.ops.varying import varying_like

WORD = 32
LARGEST = float(jnp.finfo(jnp.float32).max)
BINS = 8
HALF_OCTAVE = 22  # a float's bits above this place step by half an octave
INFINITE = 0x7F800000  # bits of infinity: no score of a candidate lies as high
FULL = 15  # words that a bin of four bits can count
ROUNDS = 12  # eight bins cut the 31 bits of a float above zero down to one in eleven rounds


class Threshold(NamedTuple):
    """A threshold per row.

    Attributes:
        value: Scores <= value are selected `[...]`.
        complete: True where no more than `most` are, and no fewer than `least` unless there are no more `[...]`.
        above: At least `least` scores are <= above, or all of them `[...]`; more than `most` where `value` is not complete.
        tied: True where no threshold exists, as more scores than there is room for are equal to `above` `[...]`.
    """

    value: Float[Array, "..."]
    complete: Bool[Array, "..."]
    above: Float[Array, "..."]
    tied: Bool[Array, "..."]


class _Search(NamedTuple):
    """Brackets `[...]` in float-bit order: fewer than `least` scores lie below `low`, more than `most` below `high`.

    `edge` is -1 until a row is settled. Few arrays are carried, and bins made from them where they are needed: a loop over
    small arrays costs by the number of its kernels.
    """

    step: Int[Array, ""]
    edge: Int[Array, "..."]
    low: Int[Array, "..."]
    high: Int[Array, "..."]
    counts: UInt[Array, "... g 32"]


def narrow(
    score: Callable[[Any, int], Array],
    operands: Any,
    *,
    words: int,
    least: int | Int[Array, ""],
    most: int | Int[Array, ""],
    guess: Float[Array, "..."],
    active: Bool[Array, "..."],
    patience: int | Int[Array, ""] = 0,
) -> Threshold:
    """Find thresholds that select between `least` and `most` scores of each row, or all if there are no more than `most`.

    Args:
        score: The scores `[..., 32]` of one word as a function of `operands` and the word's number; inf for none.
        operands: What `score` is made from.
        words: Number of words. Static.
        least: Smallest count wanted.
        most: Largest count accepted.
        guess: Where to look first, above zero `[...]`.
        active: Rows that matter `[...]`; others never keep the loop going.
        patience: So many rows may go without a threshold that a longer search would find.

    Returns:
        Thresholds; where ties leave none, one that selects too few.
    """

    middle = lax.bitcast_convert_type(jnp.minimum(guess, 1e37), jnp.int32)
    around = jnp.maximum(middle - ((BINS // 2) << HALF_OCTAVE), 0)

    def measure(search: _Search) -> Array:
        start, shift = _bins(search, around)
        return _histogram(lambda word: score(operands, word), words, start, shift)

    def unsettled(search: _Search) -> Array:
        return (search.step < ROUNDS) & (jnp.sum(search.edge < 0, dtype=jnp.int32) > patience)

    def once(search: _Search) -> _Search:
        now = _settle(search, *_bins(search, around), least, most)._replace(step=search.step + 1)
        # Counts are carried from round to round: as a value of the loop they are one pass, read by several consumers.
        counts = lax.cond(unsettled(now), measure, lambda now: now.counts, now)
        return now._replace(counts=counts)

    none = jnp.zeros(guess.shape, dtype=jnp.int32)
    # The first round finds no counts and measures: so what the scores are made from reaches the loop as finished arrays.
    counts = jnp.zeros((*guess.shape, -(-words // FULL), WORD), dtype=jnp.uint32)
    first = _Search(jnp.int32(-1), jnp.where(active, -1, none), none, none + INFINITE, counts)
    last = lax.while_loop(unsettled, once, varying_like(first, operands, guess, active))
    edge = jnp.where(last.edge >= 0, last.edge, last.low)
    value, above = (
        lax.bitcast_convert_type(jnp.clip(each - 1, 0, INFINITE - 1), jnp.float32) for each in (edge, last.high)
    )
    settled = active & (last.edge >= 0)
    complete = settled & ((edge > last.low) | (edge == INFINITE))
    return Threshold(value, complete, jnp.where(complete, value, above), settled & ~complete)


def apart(function: Callable[..., Any], sure: Bool[Array, ""], *operands: Any) -> Any:
    """What `function` makes of finished arrays, as finished arrays.

    XLA would fuse a gather or a bit search into each of its consumers and do it again for every pair of candidates. It does
    not look into the branches of a condition, so `sure` is one that always holds but that XLA cannot know to hold.
    """

    def always(*operands: Any) -> Any:
        return varying_like(function(*operands), operands)

    def never(*operands: Any) -> Any:
        nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(function, *operands))
        return varying_like(nothing, operands)

    return lax.cond(sure, always, never, *operands)


def in_pieces(count: Callable[[slice], Array], size: int) -> Array:
    """The sum of what `count` makes of up to 32 columns at a time.

    XLA's loops over more are not vectorised on a CPU where rows are compared with each other, and take 30 times as long:
    ranking 120 columns of 8,192 rows takes 134 ms at once and 4 ms in pieces.
    """
    return reduce(add, (count(slice(first, min(first + WORD, size))) for first in range(0, size, WORD)))


def selected(score: Float[Array, "... w 32"], threshold: Float[Array, "..."]) -> UInt[Array, "... w"]:
    """One bit per score, set where score <= threshold."""
    hit = (score <= threshold[..., None, None]).astype(jnp.uint32)
    return jnp.sum(hit << _ramp(score.ndim, WORD, jnp.uint32), axis=-1, dtype=jnp.uint32)


def columns(words: UInt[Array, "... w"], m: int) -> Int[Array, "... m"]:
    """Column numbers of the first `m` set bits of each row, ascending; -1 where there are fewer."""
    ndim, w = words.ndim, words.shape[-1]
    count = lax.population_count(words).astype(jnp.int32)
    earlier = jnp.asarray(np.arange(w)[:, None] > np.arange(w)[None, :]).reshape((1,) * (ndim - 1) + (w, w))
    start = jnp.sum(jnp.where(earlier, count[..., None, :], 0), axis=-1, dtype=jnp.int32)
    end = start + count
    nth = _ramp(ndim, m)
    holds = (start[..., None, :] <= nth[..., None]) & (nth[..., None] < end[..., None, :])
    word = jnp.sum(jnp.where(holds, words[..., None, :], 0), axis=-1, dtype=jnp.uint32)
    rank = nth - jnp.sum(jnp.where(holds, start[..., None, :], 0), axis=-1, dtype=jnp.int32)
    column = WORD * jnp.sum(jnp.where(holds, _ramp(ndim + 1, w), 0), axis=-1, dtype=jnp.int32)
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


def _bins(search: _Search, around: Int[Array, "..."]) -> tuple[Int[Array, "..."], Int[Array, "..."]]:
    """Where the next bins start, and how many bits wide they are: half octaves at first, then an eighth of the bracket."""
    width = jnp.maximum(search.high - search.low - 1, 1)
    narrower = jnp.maximum(32 - lax.clz(width) - 3, 0)
    at_first = search.step <= 0
    return jnp.where(at_first, around, search.low), jnp.where(at_first, HALF_OCTAVE, narrower)


def _settle(search: _Search, start: Array, shift: Array, least: int | Array, most: int | Array) -> _Search:
    """Read the histogram: settle rows with a good edge, and tighten the brackets of the others."""
    # Bins of four bits become bytes, which hold the sum of sixteen columns.
    halves = search.counts.reshape(*search.counts.shape[:-1], 2, WORD // 2)
    fields = jnp.stack([jnp.sum((halves >> bits) & 0x0F0F0F0F, axis=-1, dtype=jnp.uint32) for bits in (0, 4)])
    byte = jnp.arange(0, WORD, 8, dtype=jnp.uint32).reshape((-1, *(1,) * fields.ndim))
    bins = jnp.sum((fields[None] >> byte) & 0xFF, axis=(-2, -1), dtype=jnp.uint32).astype(jnp.int32)
    bins = bins.reshape(BINS, *start.shape)  # along the first axis, so that all work on rows is vectorised
    up_to = jnp.asarray(np.tri(BINS, dtype=bool)).reshape(BINS, BINS, *(1,) * start.ndim)
    below = jnp.sum(jnp.where(up_to, bins[None], 0), axis=1, dtype=jnp.int32)
    # The sums ascend: so many bins, from the first on, hold too few scores below their ends, and so many not too many.
    numbers = jnp.sum(jnp.where(below < least, 1, 0) + jnp.where(below <= most, WORD, 0), axis=0, dtype=jnp.int32)
    few, fine = numbers % WORD, numbers // WORD

    def end(bin_: Array) -> Array:
        within = start.astype(jnp.uint32) + ((bin_ + 1).astype(jnp.uint32) << shift.astype(jnp.uint32))
        return jnp.where(bin_ < BINS - 1, jnp.minimum(within, INFINITE).astype(jnp.int32), INFINITE)

    low = jnp.where(few > 0, jnp.maximum(search.low, end(few - 1)), search.low)
    high = jnp.where(fine < BINS, jnp.minimum(search.high, end(fine)), search.high)
    fits = (few < fine) | (fine == BINS)  # the last bin's edge will do where all scores together are too few
    edge = jnp.where(fits, end(jnp.minimum(few, BINS - 1)), jnp.where(high - low <= 1, low, -1))
    edge = jnp.where(search.edge >= 0, search.edge, edge)
    nothing_counted = search.step < 0
    now = ((edge, search.edge), (low, search.low), (high, search.high))
    edge, low, high = (jnp.where(nothing_counted, old, new) for new, old in now)
    return search._replace(edge=edge, low=low, high=high)


def _ramp(ndim: int, size: int, dtype=jnp.int32) -> Array:
    """0, 1, ... along the last of `ndim` axes."""
    return jnp.arange(size, dtype=dtype).reshape((1,) * (ndim - 1) + (size,))
