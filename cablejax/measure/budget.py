"""The uncertainty of a diameter, source by source, after the Guide to the Expression of Uncertainty in Measurement."""

import numpy as np

from cablejax.measure.alignment import Profile
from cablejax.measure.beams import BeamBias
from cablejax.measure.fit import CableFit
from cablejax.measure.result import BudgetLine

COVERAGE = 1.96
ROUNDING = 1e-5


def uncertainty_budget(
    fit: CableFit, profile: Profile | None, *, bias: BeamBias, higher_mm: float, scale_std: float, filter_std_mm: float
) -> list[BudgetLine]:
    """Sources of uncertainty of the diameter, each with its standard deviation in mm.

    Args:
        fit: The fit of axis and radius.
        profile: Errors shared by whole directions, as of stations that do not fit together; None where every station's
            shift is part of the fit.
        bias: What the beams have done to the diameter, and was taken off.
        higher_mm: What the noise does to the diameter beyond that.
        scale_std: Relative standard deviation of the scanner's scale.
        filter_std_mm: Standard deviation of the diameter that a filter applied before has left.
    """
    random = 2 * fit.random_mm
    # What exceeds independent noise is shown as lines of its own, one estimate from short patches, one from directions.
    correlated = 2 * float(np.sqrt(max(fit.clustered_mm**2 - fit.random_mm**2, 0.0)))
    shared, how = 0.0, "each sweep's shift is fitted with the axis; its doubt is in the first line"
    if profile is not None:
        shared = 2 * profile.std_mm
        how = f"sweeps unknown: shifts of {profile.shared_mm:.2g} mm, from the mean residual around the circumference"
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
            how,
        ),
        BudgetLine(
            "noise along the beams",
            bias.doubt_mm,
            "B",
            bias.how,
        ),
    ]
    rounding = ROUNDING * 2 * fit.radius_mm
    lines += [
        BudgetLine(
            "noise of higher order",
            higher_mm,
            "B",
            "what noise does to the fitted cable scanned anew beyond the formula; of a known scanner 30 s^3 / R^2",
        ),
        BudgetLine("rounding and the axis's spline", rounding, "B", f"{ROUNDING:g} of the diameter"),
    ]
    given = [
        (scale_std * 2 * fit.radius_mm, "scale", "scale of the scanner as given"),
        (filter_std_mm, "filter", "left by the filter as given"),
    ]
    return lines + [BudgetLine(source, float(std), "B", how) for std, source, how in given if std > 0]


def unseen_errors(shared_mm: float, radius_std_mm: float) -> BudgetLine:
    """What errors that neighbouring points share may hold of another radius."""
    how = f"neighbours share errors of {shared_mm:.2g} mm; a part of such errors looks like another radius"
    return BudgetLine("shared errors that look like another radius", 2 * radius_std_mm, "B", how)


def combined(lines: list[BudgetLine]) -> float:
    """Root of the sum of squares: the sources are independent."""
    return float(np.sqrt(sum(line.std_mm**2 for line in lines)))
