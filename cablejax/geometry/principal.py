"""Principal axes of points: where they lie, along what they spread, and how far."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Principal(NamedTuple):
    """Principal axes, the longest first.

    Attributes:
        center: Mean `[3]`.
        axes: Unit vectors `[a, 3]`, a row each, of either sign; a = 3 where there are three points or more.
        std: Standard deviations along them `[a]`.
    """

    center: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "a 3"]
    std: Float[np.ndarray, " a"]


def principal_axes(xyz: Float[np.ndarray, "n 3"]) -> Principal:
    """Principal axes by singular values, which see spreads of 1e-9 of the largest; covariances see 1e-8 at best.

    Example:
        >>> along = principal_axes(np.array([[0.0, 0, 0], [3, 4, 0], [6, 8, 0.1]])).axes[0]
        >>> np.abs(along).round(2).tolist()
        [0.6, 0.8, 0.01]
    """
    center = xyz.mean(axis=0)
    _, values, axes = np.linalg.svd(xyz - center, full_matrices=False)
    return Principal(center, axes, values / np.sqrt(len(xyz)))


def facing_up(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A direction or its opposite: the one whose largest component is positive.

    Example:
        >>> facing_up(np.array([0.6, -0.8, 0.0])).tolist()
        [-0.6, 0.8, -0.0]
    """
    return direction * np.sign(direction[np.argmax(np.abs(direction))])
