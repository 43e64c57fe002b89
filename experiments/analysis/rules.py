"""Verdicts by rule, in five words; docs/study.md states the rules before the results that they are held against."""

from collections.abc import Iterable

from experiments.analysis.inference import Comparison

REPRODUCED, IN_PART, NOT_REPRODUCED = "reproduced", "in part", "not reproduced"
INCONCLUSIVE, CANNOT_BE = "inconclusive", "cannot be"
WORDS = (REPRODUCED, IN_PART, NOT_REPRODUCED, INCONCLUSIVE, CANNOT_BE)
HOLDS, REFUTED, NIL, OPEN = "holds", "refuted", "nil", "open"
LEVEL = 0.05
ACCURACY_MARGIN = 0.01  # a difference in accuracy that matters to nobody
SPEED_FACTOR = 1.1  # likewise, of updates


def outcome(found: Comparison, *, margin: float) -> str:
    """What a comparison says of the claim that its effect is above 0.

    Args:
        found: Effect, interval and adjusted p-value.
        margin: Effects of this size or less are practically nil.

    Returns:
        "holds" or "refuted" where the interval lies on one side of 0 and p is at most 0.05; "nil" where the interval
        lies within the margin; else "open". An effect that is sure but within the margin is nil: it is of no use.
    """
    effect = found.effect
    if -margin <= effect.low and effect.high <= margin:
        return NIL
    if found.p <= LEVEL and effect.low > 0:
        return HOLDS
    if found.p <= LEVEL and effect.high < 0:
        return REFUTED
    return OPEN


def verdict(comparisons: Iterable[Comparison], *, margin: float = ACCURACY_MARGIN) -> str:
    """The word for a claim that all of these effects are above 0; "cannot be" where there is nothing to compare."""
    found = [outcome(each, margin=margin) for each in comparisons]
    if not found:
        return CANNOT_BE
    if all(each == HOLDS for each in found):
        return REPRODUCED
    if HOLDS in found:
        return IN_PART
    return NOT_REPRODUCED if REFUTED in found or NIL in found else INCONCLUSIVE
