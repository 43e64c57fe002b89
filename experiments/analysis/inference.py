"""Statistics of the study: intervals that stay in [0, 1], paired comparisons, time to target, trials and profiles.

docs/study.md says which is used for what. Resampling is seeded: the same numbers give the same intervals.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

RESAMPLES = 10_000
EXACT = 12  # pairs up to which every assignment of signs is counted


class Interval(NamedTuple):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float

    def format(self, digits: int) -> str:
        """As a table prints it.

        Example:
            >>> Interval(0.95, 0.9, 0.975).format(3)
            '0.950 [0.900, 0.975]'
        """
        return f"{self.value:.{digits}f} [{self.low:.{digits}f}, {self.high:.{digits}f}]"


def _sample(values: Sequence[float], name: str = "values") -> Float[np.ndarray, " n"]:
    if not len(values):
        raise ValueError(f"{name}: expected at least one number, got none")
    return np.asarray(values, dtype=np.float64)


def wilson(successes: int, n: int) -> Interval:
    """A share with Wilson's 95 % score interval, which is never empty and never leaves [0, 1].

    Raises:
        ValueError: If `n` is below 1, or `successes` not in 0 ... n.
    """
    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"successes: expected 0 to n of at least 1, got {successes} of {n}")
    z = float(stats.norm.ppf(0.975))
    share, spread = successes / n, z * z / n
    middle = (share + spread / 2) / (1 + spread)
    half = z * math.sqrt(share * (1 - share) / n + spread / (4 * n)) / (1 + spread)
    # At the ends the score interval touches 0 or 1 exactly, which roundings miss.
    return Interval(share, 0.0 if successes == 0 else middle - half, 1.0 if successes == n else middle + half)


def interquartile_mean(values: Sequence[float] | Float[np.ndarray, "... n"]) -> Any:
    """Mean of the middle half along the last axis: the lowest and the highest quarter, whole values, are left out.

    Example:
        >>> float(interquartile_mean([0.0, 1.0, 2.0, 100.0]))
        1.5
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    n = ordered.shape[-1]
    return ordered[..., n // 4 : n - n // 4].mean(axis=-1)


def mean(values: Sequence[float] | Float[np.ndarray, "... n"]) -> Any:
    """Mean along the last axis."""
    return np.mean(values, axis=-1)


def bootstrap(values: Sequence[float], statistic: Callable[[Any], Any] = interquartile_mean) -> Interval:
    """A statistic, which works along the last axis, with its percentile bootstrap 95 % interval.

    A mean of resampled values lies among them, so that shares keep an interval in [0, 1]; of a single value it is the point.
    """
    sample = _sample(values)
    rows = np.random.default_rng(0).integers(len(sample), size=(RESAMPLES, len(sample)))
    low, high = np.quantile(statistic(sample[rows]), (0.025, 0.975), method="inverted_cdf")
    return Interval(float(statistic(sample)), float(low), float(high))


class Comparison(NamedTuple):
    """First minus second, paired.

    Attributes:
        effect: Mean difference with its bootstrap interval.
        p: Of the two-sided sign-flip permutation test; Holm-adjusted where `holm` has been.
        n: Pairs.
    """

    effect: Interval
    p: float
    n: int


def compare(first: Sequence[float], second: Sequence[float]) -> Comparison:
    """Compare two arms over the same seeds.

    Raises:
        ValueError: If the two differ in length.
    """
    if len(first) != len(second):
        raise ValueError(f"second: expected {len(first)} values, one for each of first, got {len(second)}")
    difference = _sample(first, "first") - _sample(second, "second")
    return Comparison(bootstrap(difference.tolist(), mean), sign_flip(difference), len(difference))


def sign_flip(differences: Float[np.ndarray, " n"]) -> float:
    """Two-sided p-value of the mean of paired differences, were their signs a matter of chance.

    All `2^n` assignments of signs up to twelve pairs, else `RESAMPLES` random ones, the observed one counted among them.

    Example:
        >>> sign_flip(np.array([1.0, 2.0, 3.0]))  # 2 of 8: all signs as they are, and all turned round
        0.25
    """
    n = len(differences)
    if n <= EXACT:
        signs = np.array(list(itertools.product((1.0, -1.0), repeat=n)))
    else:
        random = np.random.default_rng(0).choice((1.0, -1.0), size=(RESAMPLES, n))
        signs = np.concatenate([np.ones((1, n)), random])
    sums = np.abs(signs @ differences)
    return float(np.mean(sums >= sums[0] - 1e-9 * np.abs(differences).sum()))


def holm(p_values: Mapping[str, float]) -> dict[str, float]:
    """Holm's step-down adjustment: chance of any false rejection among all of them, at most the level.

    Example:
        >>> holm({"a": 0.01, "b": 0.04, "c": 0.03})
        {'a': 0.03, 'b': 0.06, 'c': 0.06}
    """
    adjusted, highest = {}, 0.0
    for i, name in enumerate(sorted(p_values, key=lambda name: p_values[name])):
        highest = max(highest, min(1.0, (len(p_values) - i) * p_values[name]))
        adjusted[name] = highest
    return {name: adjusted[name] for name in p_values}


def compare_all(own: Sequence[float], rivals: Mapping[str, Sequence[float]]) -> dict[str, Comparison]:
    """One arm against each of the others, p-values Holm-adjusted."""
    found = {name: compare(own, other) for name, other in rivals.items()}
    adjusted = holm({name: each.p for name, each in found.items()})
    return {name: each._replace(p=adjusted[name]) for name, each in found.items()}


def epochs_to_target(validation: Sequence[float], target: float) -> float:
    """The first epoch, counted from 1, whose validation accuracy is at least the target; infinite if there is none."""
    return next((float(i) for i, value in enumerate(validation, start=1) if value >= target), math.inf)


def best_of(trials: Sequence[float]) -> Float[np.ndarray, " trials"]:
    """Expected best of n of the trials drawn without replacement, for n = 1 ... all of them `[trials]`.

    The i-th smallest of m is the best of n draws with probability C(i - 1, n - 1) / C(m, n).

    Example:
        >>> best_of([0.0, 1.0, 0.5]).round(3).tolist()
        [0.5, 0.833, 1.0]
    """
    ordered = np.sort(_sample(trials, "trials"))
    m = len(ordered)
    return np.array(
        [sum(math.comb(i, n - 1) * ordered[i] for i in range(m)) / math.comb(m, n) for n in range(1, m + 1)]
    )


def performance_profile(
    costs: Mapping[str, Mapping[str, Sequence[float]]], factors: Sequence[float]
) -> dict[str, list[float]]:
    """For each arm the share of its (part, seed) pairs that cost at most a factor times the best arm's median of the part.

    Args:
        costs: Cost by arm, part and seed; infinite where the target was not reached. Every arm has every part.
        factors: Of at least 1.

    Raises:
        ValueError: If an arm lacks a part.
    """
    parts = sorted({part for arm in costs.values() for part in arm})
    for arm, own in costs.items():
        if sorted(own) != parts:
            raise ValueError(
                f"costs: expected {', '.join(parts)} for every arm, got {', '.join(sorted(own))} for {arm}"
            )
    least = {part: min(float(np.median(arm[part])) for arm in costs.values()) for part in parts}
    shares = {}
    for arm, own in costs.items():
        # Where no arm reaches the target there is no best one, and nobody is within any factor of it.
        ratio = np.array(
            [cost / least[part] if np.isfinite(least[part]) else np.inf for part in parts for cost in own[part]]
        )
        shares[arm] = [float(np.mean(ratio <= factor)) for factor in factors]
    return shares
