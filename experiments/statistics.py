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
