"""What a table says of several seeds: the mean and a 95 % interval."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats


class Estimate(NamedTuple):
    """Mean over seeds, half the width of its 95 % interval (nan for one seed), and the number of seeds."""

    mean: float
    half_width: float
    n: int

    def format(self, digits: int) -> str:
        """Mean and half width, as a table prints them.

        Example:
            >>> Estimate(1.25, 0.04, 3).format(2)
            '1.25 ± 0.04'
            >>> Estimate(1.25, float("nan"), 1).format(2)
            '1.25'
        """
        if np.isnan(self.mean):
            return "-"
        text = f"{self.mean:,.{digits}f}"
        return text if np.isnan(self.half_width) else f"{text} ± {self.half_width:,.{digits}f}"


def estimate(values: Sequence[float]) -> Estimate:
    """Mean and Student-t 95 % interval of one number per seed.

    Raises:
        ValueError: If there is no value.
    """
    if not values:
        raise ValueError("values: expected at least one number, got none")
    sample = np.asarray(values, dtype=np.float64)
    n = sample.size
    half = float("nan") if n == 1 else float(stats.t.ppf(0.975, n - 1) * sample.std(ddof=1) / np.sqrt(n))
    return Estimate(float(sample.mean()), half, n)


def paired_difference(first: Sequence[float], second: Sequence[float]) -> tuple[Estimate, float]:
    """The mean of `first - second`, seed by seed, with its interval, and the p-value of the paired t test.

    Raises:
        ValueError: If the two differ in length.
    """
    if len(first) != len(second):
        raise ValueError(f"second: expected {len(first)} values, one for each of first, got {len(second)}")
    differences = np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64)
    if len(differences) < 2 or not differences.std():
        return estimate(differences.tolist()), float("nan")
    _, p_value = stats.ttest_1samp(differences, 0.0)
    return estimate(differences.tolist()), float(np.asarray(p_value))


def fluctuation(loss: Sequence[float]) -> float:
    """How much a loss curve jumps: its root mean square about the mean of three epochs, over the second half of the run.

    Returns:
        In the loss's unit; nan for fewer than four epochs.

    Example:
        >>> fluctuation([4.0, 3.0, 2.0, 1.0])
        0.0
    """
    if len(loss) < 4:
        return float("nan")
    curve = np.asarray(loss, dtype=np.float64)
    rough = curve[1:-1] - (curve[:-2] + curve[1:-1] + curve[2:]) / 3
    return float(np.sqrt(np.mean(np.square(rough[len(rough) // 2 :]))))


def fluctuation_of_updates(losses: Sequence[float], per_epoch: int) -> float:
    """Root mean square of single updates' losses about their running mean over an epoch's updates, behind the first epoch.

    Example:
        >>> fluctuation_of_updates([9.0, 9.0, 1.0, 2.0, 3.0, 4.0], 2)  # a steady slope: half a step on either side
        0.5
    """
    kept = np.asarray(losses[per_epoch:], float)
    if len(kept) <= per_epoch:
        return float("nan")
    mean = np.convolve(kept, np.ones(per_epoch) / per_epoch, mode="valid")
    start = (per_epoch - 1) // 2
    return float(np.sqrt(np.mean((kept[start : start + len(mean)] - mean) ** 2)))
