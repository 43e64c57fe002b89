"""Select the smallest of many scores per row without sorting: narrow a threshold by counting, then read the winners' bits.

Sorting and top-k are slow on a CPU and hard to vectorise; counting `score <= threshold` is one fused pass at memory speed. As
scores of points on a surface grow nearly linearly in rank, three or four passes of three thresholds each settle most rows.
Scores come as `[..., w, 32]`, 32 to a word.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

WORD = 32
LARGEST = float(jnp.finfo(jnp.float32).max)


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
    rounds: int = 10,
) -> Threshold:
    """Find thresholds that select between `least` and `most` scores of each row.

    Args:
        score: Scores `[..., w, 32]` as a function of `operands`, cheap enough to be measured anew in every round.
        operands: What `score` is made from.
        least: Smallest count wanted. Static.
        most: Largest count accepted. Static.
        guess: Where to look first `[...]`.
        cap: No threshold above this is needed `[...]`; it is taken if at most `most` scores lie below it.
        rounds: Passes at most. Static.

    Returns:
        Thresholds; where none was found in time, one that selects too few, or more than `most` if there is no other.
    """
    aim = 0.5 * (least + most)

    def unsettled(state: tuple) -> Array:
        return (state[0] < rounds) & ~state[1].all()

    def once(state: tuple) -> tuple:
        step, settled, value, low, low_count, high, high_count = state
        open_above = high >= LARGEST
        share = (aim - low_count) / jnp.maximum(high_count - low_count, 1)
        middle = low + jnp.where(open_above, low, (high - low) * share)
        # Between scales, where interpolation would creep: the mean of the float's bits, nearly the geometric mean.
        bits = [lax.bitcast_convert_type(jnp.maximum(edge, high * 2.0**-24), jnp.int32) for edge in (low, high)]
        geometric = lax.bitcast_convert_type((bits[0] >> 1) + (bits[1] >> 1), jnp.float32)
        spread = jnp.where(step % 2 == 1, middle + (high - middle) * 0.3, geometric)
        first = step == 0
        trials = (
            jnp.where(first, cap, jnp.minimum(middle, cap)),
            jnp.where(first, guess, jnp.where(open_above, low * 4.0, low + (middle - low) * 0.7)),
            jnp.where(first, guess * 1.5, jnp.where(open_above, low * 16.0, spread)),
        )
        # The barrier ties the scores to this round: XLA would otherwise hoist them out of the loop, into memory.
        now, trials = lax.optimization_barrier((operands, trials))
        for trial, count in zip(trials, _count(score(now), trials), strict=True):
            fits = (count <= most) & ((count >= least) | (trial >= cap))
            value = jnp.where(fits & ~settled, trial, value)
            settled = settled | fits
            below = (count < least) & (trial > low)
            low, low_count = jnp.where(below, trial, low), jnp.where(below, count, low_count)
            above = (count > most) & (trial < high)
            high, high_count = jnp.where(above, trial, high), jnp.where(above, count, high_count)
        return step + 1, settled, value, low, low_count, high, high_count

    zero = jnp.zeros_like(guess)
    none = jnp.zeros(guess.shape, dtype=jnp.int32)
    start = (jnp.int32(0), none > 0, zero, zero, none, zero + LARGEST, none + most + 1)
    _, settled, value, low, low_count, high, _ = lax.while_loop(unsettled, once, start)
    some = low_count > 0
    return Threshold(jnp.where(settled, value, jnp.where(some, low, high)), settled | some)


def selected(score: Float[Array, "... w 32"], threshold: Float[Array, "..."]) -> UInt[Array, "... w"]:
    """One bit per score, set where score <= threshold."""
    hit = (score <= threshold[..., None, None]).astype(jnp.uint32)
    return jnp.sum(hit << jnp.arange(WORD, dtype=jnp.uint32), axis=-1)


def columns(words: UInt[Array, "... w"], m: int) -> Int[Array, "... m"]:
    """Column numbers of the first `m` set bits of each row, ascending; -1 where there are fewer."""
    count = lax.population_count(words).astype(jnp.int32)
    before = jnp.arange(words.shape[-1])[:, None] > jnp.arange(words.shape[-1])
    start = jnp.sum(jnp.where(before, count[..., None, :], 0), axis=-1)
    end = start + count
    nth = jnp.arange(m, dtype=jnp.int32)
    holds = (start[..., None, :] <= nth[:, None]) & (nth[:, None] < end[..., None, :])
    word = jnp.sum(jnp.where(holds, words[..., None, :], 0), axis=-1, dtype=jnp.uint32)
    rank = nth - jnp.sum(jnp.where(holds, start[..., None, :], 0), axis=-1)
    column = WORD * jnp.sum(jnp.where(holds, jnp.arange(words.shape[-1], dtype=jnp.int32), 0), axis=-1)
    for half in (16, 8, 4, 2, 1):
        low = word & jnp.uint32((1 << half) - 1)
        skipped = lax.population_count(low).astype(jnp.int32)
        upper = rank >= skipped
        word = jnp.where(upper, word >> half, low)
        rank = jnp.where(upper, rank - skipped, rank)
        column = jnp.where(upper, column + half, column)
    return jnp.where(nth < end[..., -1:], column, -1)


def _count(score: Array, trials: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """How many scores of each row lie at or below each of three thresholds: one pass, three counters of ten bits."""
    hits = sum((score <= t[..., None, None]).astype(jnp.int32) << (10 * i) for i, t in enumerate(trials))
    per_word = jnp.sum(hits, axis=-1)
    if score.shape[-2] * WORD < 1 << 10:
        per_word = jnp.sum(per_word, axis=-1)
        return tuple((per_word >> (10 * i)) & 1023 for i in range(3))
    return tuple(jnp.sum((per_word >> (10 * i)) & 1023, axis=-1) for i in range(3))
