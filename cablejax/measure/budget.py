"""The uncertainty of a diameter, source by source, after the Guide to the Expression of Uncertainty in Measurement."""

import numpy as np

from cablejax.measure.alignment import Profile
from cablejax.measure.fit import CableFit
from cablejax.measure.result import BudgetLine

COVERAGE = 1.96


def noise_bias_mm(fit: CableFit) -> float:
    """How much noise enlarges the diameter: a point moved along the surface by t ends up t^2 / 2r outside the circle.

    Noise across the line of sight is taken to be as large as the residuals' own, in each direction.
    """
    return fit.noise_mm**2 / fit.radius_mm


def uncertainty_budget(
    fit: CableFit, profile: Profile | None, *, scale_std: float, filter_std_mm: float
) -> list[BudgetLine]:
    """Sources of uncertainty of the diameter, each with its standard deviation in mm.

    Args:
        fit: The fit of axis and radius.
        profile: Errors shared by whole directions, as of stations that do not fit together; None where unknown.
        scale_std: Relative standard deviation of the scanner's scale.
        filter_std_mm: Standard deviation of the diameter that a filter applied before has left.
    """
    random = 2 * fit.random_mm
    # What exceeds independent noise is shown as lines of its own, one estimate from short patches, one from directions.
    correlated = 2 * float(np.sqrt(max(fit.clustered_mm**2 - fit.random_mm**2, 0.0)))
    shared = 0.0 if profile is None else 2 * float(np.sqrt(max(profile.std_mm**2 - fit.random_mm**2, 0.0)))
    depth = 0.0 if profile is None else profile.shared_mm
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
            "alignment of the stations",
            shared,
            "A",
            f"errors of {depth:.2g} mm that whole directions share, from the mean residual around the circumference",
        ),
        BudgetLine(
            "noise along the surface",
            noise_bias_mm(fit) / np.sqrt(3),
            "B",
            "the correction for it, good to its own size with even probability",
        ),
    ]
    given = [
        (scale_std * 2 * fit.radius_mm, "scale", "scale of the scanner as given"),
        (filter_std_mm, "filter", "left by the filter as given"),
    ]
    return lines + [BudgetLine(source, float(std), "B", how) for std, source, how in given if std > 0]


def combined(lines: list[BudgetLine]) -> float:
    """Root of the sum of squares: the sources are independent."""
    return float(np.sqrt(sum(line.std_mm**2 for line in lines)))
