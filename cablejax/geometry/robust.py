"""Spread and intervals of Gaussian numbers, told robustly."""

import numpy as np
from jaxtyping import Float

MAD_STD = 1.4826  # standard deviations in a median absolute deviation
COVERAGE = 1.96  # standard deviations in half of a 95 % interval


def robust_std(deviation: Float[np.ndarray, " n"]) -> float:
    """Standard deviation about zero, from the median absolute value: up to half of the points may be anything.

    Example:
        >>> robust_std(np.array([-1.0, 1.0, 1.0, -1.0, 500.0]))
        1.4826
    """
    return MAD_STD * float(np.median(np.abs(deviation)))
