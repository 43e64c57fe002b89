"""Coordinates written with few digits: multiples of a step that may be coarse for a cable."""

import numpy as np
from jaxtyping import Float

from cablejax.measure.errors import MeasureError

REPEATED = 3.0  # points to a value, on average: fewer repeat by chance, or with steps too fine to matter
DIGITS = 1e-6  # of the extent, within which two values are one
EVEN = 0.1  # of a step, by which gaps between values may miss its multiples
SHARE = 0.95  # of the gaps that must be multiples
COARSE = 0.25  # of the diameter: a section whose points stand in four rows has no shape
NOTED = 0.05  # of the diameter


def coordinate_steps(xyz: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "3"]:
    """The step that each coordinate is a multiple of; 0 where there is none.

    Args:
        xyz: Points as the file has them, shifted perhaps but not turned, any unit.

    Example:
        >>> x = np.arange(60.0)
        >>> coordinate_steps(np.stack([x % 7 * 2.5, np.sqrt(x), x // 10], axis=1)).round(3).tolist()
        [2.5, 0.0, 1.0]
    """
    return np.array([_step(column) for column in xyz.T])


def _step(column: Float[np.ndarray, " m"]) -> float:
    extent = float(np.ptp(column))
    if extent == 0:
        return 0.0
    values = np.unique(np.round((column - column.min()) / (DIGITS * extent)))
    if len(values) * REPEATED > len(column):
        return 0.0
    gaps = np.diff(values) * DIGITS * extent
    step = float(np.median(gaps[gaps < 1.5 * np.quantile(gaps, 0.05)]))
    even = np.abs(gaps / step - np.round(gaps / step)) < EVEN
    return step if even.mean() >= SHARE else 0.0


def step_across(xyz: Float[np.ndarray, "m 3"], direction: Float[np.ndarray, "3"]) -> float:
    """The coarsest step that the coordinates have across a unit direction, in mm."""
    return float(np.max(coordinate_steps(xyz) * np.sqrt(np.maximum(1.0 - direction**2, 0.0))))


def too_coarse(step_mm: float, diameter_mm: float) -> MeasureError | None:
    """The error where the coordinates' steps leave a section no shape."""
    if step_mm <= COARSE * diameter_mm:
        return None
    return MeasureError(
        f"The diameter cannot be told: the coordinates are multiples of {step_mm:.3g} mm, and what is roundest is some "
        f"{diameter_mm:.3g} mm across. Write the scan with more digits."
    )


def about_steps(step_mm: float, diameter_mm: float) -> list[str]:
    """A sentence where they are coarse."""
    if step_mm <= NOTED * diameter_mm:
        return []
    return [
        f"The coordinates are multiples of {step_mm:.3g} mm, which adds to the noise: write the scan with more digits."
    ]
