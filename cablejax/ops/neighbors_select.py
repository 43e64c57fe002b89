"""Select the smallest of many scores per row without sorting: narrow a threshold by counting, then read the winners' bits.

Sorting and top-k are slow on a CPU and resist vectors; counting scores at or below a threshold is one fused pass. As the
scores of points on a surface grow nearly linearly in rank, three or four passes of three thresholds settle most rows.
Scores come as `[..., w, 32]`, 32 to a word.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

WORD = 32
LARGEST = float(jnp.finfo(jnp.float32).max)
FULL = 1 << 30  # more than any count


class Threshold(NamedTuple):
    """A threshold per row.

    Attributes:
        value: Scores <= value are selected `[...]`.
        complete: True where no more than `most` are, so that all of them find room `[...]`.
    """

    value: Float[Array, "..."]
    complete: Bool[Array, "..."]


def narrow(
    score: Callable[[Array], Array],
    operands: Array,
    *,
    least: int,
    most: int,
    guess: Float[Array, "..."],
    cap: Float[Array, "..."],
    active: Bool[Array, "..."],
    rounds: int = 10,
) -> Threshold:
    """Find thresholds that select between `least` and `most` scores of each row.

    Args:
        score: Scores `[..., w, 32]` as a function of `operands`, cheap enough to be measured anew in every round.
        operands: What `score` is made from.
        least: Smallest count wanted. Static.
        most: Largest count accepted. Static.
        guess: Where to look first, above zero `[...]`.
        cap: No threshold above this is needed `[...]`; it is taken if at most `most` scores lie below it.
        active: Rows that matter `[...]`; others never keep the loop going.
        rounds: Passes at most. Static.

    Returns:
        Thresholds; where none was found in time, one that selects too few, or more than `most` if there is no other.
    """
    aim = 0.5 * (least + most)

    def unsettled(state: tuple) -> Array:
        return (state[0] < rounds) & ~state[1].all()

    def once(state: tuple) -> tuple:
        step, settled, value, low, low_count, high, high_count = state
        trials = _trials(step, guess, cap, low, low_count, high, high_count, aim)
        # The barrier ties the scores to this round: XLA would otherwise hoist them out of the loop, into memory.
        now, trials = lax.optimization_barrier((operands, trials))
        counts = _count(score(now), trials)
        fits = (counts <= most) & ((counts >= least) | (trials >= cap[None]))
        value = jnp.where(settled, value, jnp.max(jnp.where(fits, trials, 0.0), axis=0))
        low = jnp.maximum(low, jnp.max(jnp.where(counts < least, trials, 0.0), axis=0))
        low_count = jnp.maximum(low_count, jnp.max(jnp.where(counts < least, counts, 0), axis=0))
        high = jnp.minimum(high, jnp.min(jnp.where(counts > most, trials, LARGEST), axis=0))
        high_count = jnp.minimum(high_count, jnp.min(jnp.where(counts > most, counts, FULL), axis=0))
        return step + 1, settled | fits.any(axis=0), value, low, low_count, high, high_count

    zero = jnp.zeros_like(guess)
    none = jnp.zeros(guess.shape, dtype=jnp.int32)
    start = (jnp.int32(0), ~active, zero, zero, none, zero + LARGEST, none + FULL)
    _, settled, value, low, low_count, high, _ = lax.while_loop(unsettled, once, start)
    some = low_count > 0
    return Threshold(jnp.where(settled, value, jnp.where(some, low, high)), settled | some)


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


def _trials(step, guess, cap, low, low_count, high, high_count, aim) -> Float[Array, "3 ..."]:
    """Three thresholds to count at: around the guess, then outwards, then within the bracket."""
    start = jnp.stack([guess * 0.7, guess * 1.05, guess * 1.55])
    outward = jnp.stack([low * 1.5, low * 4.0, cap])
    middle = low + (high - low) * ((aim - low_count) / jnp.maximum(high_count - low_count, 1))
    # Between scales, where interpolation would creep: the mean of the floats' bits is nearly the geometric mean.
    bits = [lax.bitcast_convert_type(jnp.maximum(edge, high * 2.0**-24), jnp.int32) for edge in (low, high)]
    geometric = lax.bitcast_convert_type((bits[0] >> 1) + (bits[1] >> 1), jnp.float32)
    other = jnp.where(step % 2 == 1, middle + (high - middle) * 0.3, geometric)
    inward = jnp.stack([middle, low + (middle - low) * 0.7, other])
    later = jnp.where((high >= LARGEST)[None], outward, inward)
    return jnp.minimum(jnp.where(step == 0, start, later), cap[None])


def _count(score: Array, trials: Float[Array, "3 ..."]) -> Int[Array, "3 ..."]:
    """How many scores of each row lie at or below each of three thresholds: one pass, three counters of ten bits."""
    hits = [(score <= trials[i][..., None, None]).astype(jnp.int32) << (10 * i) for i in range(3)]
    per_word = jnp.sum(hits[0] + hits[1] + hits[2], axis=-1)
    if score.shape[-2] * WORD < 1 << 10:
        per_word = jnp.sum(per_word, axis=-1)
        return jnp.stack([(per_word >> (10 * i)) & 1023 for i in range(3)])
    return jnp.stack([jnp.sum((per_word >> (10 * i)) & 1023, axis=-1) for i in range(3)])


def _ramp(ndim: int, size: int, dtype=jnp.int32) -> Array:
    """0, 1, ... along the last of `ndim` axes."""
    return jnp.arange(size, dtype=dtype).reshape((1,) * (ndim - 1) + (size,))
