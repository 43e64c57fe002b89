"""The uncertainty of a diameter, source by source, after the Guide to the Expression of Uncertainty in Measurement."""

import numpy as np

from cablejax.measure.fit import CableFit
from cablejax.measure.result import BudgetLine

COVERAGE = 1.96


def noise_bias_mm(fit: CableFit) -> float:
    """How much noise enlarges the diameter: a point moved along the surface by t ends up t^2 / 2r outside the circle.

    Noise across the line of sight is taken to be as large as the residuals' own, in each direction.
    """
    return fit.noise_mm**2 / fit.radius_mm


def uncertainty_budget(
    fit: CableFit, *, registration_std_mm: float, scale_std: float, filter_std_mm: float
) -> list[BudgetLine]:
    """Sources of uncertainty of the diameter, each with its standard deviation in mm.

    Args:
        fit: The fit of axis and radius.
        registration_std_mm: Standard deviation of the stations' alignment, across the cable; 0 for a single station.
        scale_std: Relative standard deviation of the scanner's scale.
        filter_std_mm: Standard deviation of the diameter that a filter applied before has left.
    """
    random = 2 * fit.random_mm
    # The larger of the two estimates stands; what exceeds independent noise is shown as a line of its own.
    correlated = 2 * float(np.sqrt(max(fit.clustered_mm**2 - fit.random_mm**2, 0.0)))
    seen = int((fit.weight > 0).sum())
    lines = [
        BudgetLine(
            "noise, arc and number of points",
            random,
            "A",
            f"least squares over {seen:,} points with residuals of {fit.noise_mm:.3g} mm",
        ),
        BudgetLine(
            "residuals that hang together",
            correlated,
            "A",
            "excess of the variance between patches of 15 degrees and one diameter over that of single points",
        ),
        BudgetLine(
            "noise along the surface",
            noise_bias_mm(fit) / np.sqrt(3),
            "B",
            "the correction for it, good to its own size with even probability",
        ),
    ]
    given = [
        (registration_std_mm, "registration", "alignment of the stations as given"),
        (scale_std * 2 * fit.radius_mm, "scale", "scale of the scanner as given"),
        (filter_std_mm, "filter", "left by the filter as given"),
    ]
    return lines + [BudgetLine(source, float(std), "B", how) for std, source, how in given if std > 0]


def combined(lines: list[BudgetLine]) -> float:
    """Root of the sum of squares: the sources are independent."""
    return float(np.sqrt(sum(line.std_mm**2 for line in lines)))
