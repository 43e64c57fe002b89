"""The uncertainty of a diameter, source by source, after the Guide to the Expression of Uncertainty in Measurement."""

from collections.abc import Iterable

import numpy as np

from cablejax.measure.fit.beam_noise import BeamBias
from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.result import BudgetLine
from cablejax.measure.uncertainty.alignment import Profile

ROUNDING = 1e-5
# Names of the sources, as a budget after the GUM has them.
NOISE = "measurement noise"
CORRELATED = "correlated residuals"
REGISTRATION = "registration of the stations"
RANGE_NOISE = "bias from range noise"
HIGHER_ORDER = "bias of higher order"
NUMERICAL = "numerical rounding"
CONFOUNDED = "systematic errors confounded with the radius"
FORM = "form deviation along the axis"
LACK_OF_FIT = "lack of fit of the sections"
SCALE = "scale calibration"
FILTER = "filter bias"
LENS = "lens distortion of a depth image"
BLUR = "blur of a depth image"


def uncertainty_budget(
    fit: CableFit,
    profile: Profile | None,
    *,
    bias: BeamBias,
    higher_mm: float,
    shared_mm: float,
    unseen_mm: float,
    form: str,
    form_mm: float,
    against_mm: float,
    scale_std: float,
    filter_std_mm: float,
    lens_mm: float,
    blur_mm: float,
    one_view: bool,
) -> tuple[BudgetLine, ...]:
    """Sources of uncertainty of the diameter, each with its standard deviation in mm.

    Args:
        fit: The fit of axis and radius.
        profile: Errors shared by whole directions, as of stations that do not fit together; None where every station's
            shift is part of the fit.
        bias: What the beams have done to the diameter, and was taken off.
        higher_mm: What the noise does to the diameter beyond that.
        shared_mm: Standard deviation of the errors that neighbouring points share.
        unseen_mm: What these may hold of another radius.
        form: The stretches along the length in words.
        form_mm: Standard deviation of the diameter along the length.
        against_mm: By how much the sections' own diameters differ from the common one, beyond what both are known to.
        scale_std: Relative standard deviation of the scanner's scale.
        filter_std_mm: Standard deviation of the diameter that a filter applied before has left.
        lens_mm: What a lens distortion that was left in the scan may have done to the diameter.
        blur_mm: What the blur of a depth image may have done to it.
        one_view: Whether the scan is known to be a single view.
    """
    # What exceeds independent noise is shown as lines of its own, one estimate from short patches, one from directions.
    correlated = float(np.sqrt(max(fit.clustered_mm**2 - fit.random_mm**2, 0.0)))
    aligned, how = 0.0, "each sweep's shift is fitted with the axis; its doubt is in the first line"
    if one_view:
        how = "a single view has no alignment"
    if profile is not None:
        aligned = profile.std_mm
        how = f"sweeps unknown: shifts of {profile.shared_mm:.2g} mm, from the mean residual around the circumference"
    scattered = f"least squares over {(fit.weight > 0).sum():,} points with residuals of {fit.noise_mm:.3g} mm"
    patches = "excess of the variance between patches of 15 degrees and one diameter over that of single points"
    again = "what noise does to the fitted cable scanned anew beyond the formula; of a known scanner 30 s^3 / R^2"
    common = f"neighbours share errors of {shared_mm:.2g} mm; a part of such errors looks like another radius"
    lines = (
        BudgetLine(NOISE, 2 * fit.random_mm, "A", scattered),
        BudgetLine(CORRELATED, 2 * correlated, "A", patches),
        BudgetLine(REGISTRATION, 2 * aligned, "A", how),
        BudgetLine(RANGE_NOISE, bias.doubt_mm, "B", bias.how),
        BudgetLine(HIGHER_ORDER, higher_mm, "B", again),
        BudgetLine(
            NUMERICAL,
            ROUNDING * 2 * fit.radius_mm,
            "B",
            f"rounding and the axis's spline: {ROUNDING:g} of the diameter",
        ),
        BudgetLine(CONFOUNDED, 2 * unseen_mm, "B", common),
    )
    found = (
        BudgetLine(FORM, form_mm, "A", form),
        BudgetLine(
            LACK_OF_FIT,
            against_mm,
            "A",
            "excess of the difference between the sections' mean diameter and the fitted one over its standard deviation",
        ),
        BudgetLine(
            LENS, lens_mm, "B", "the fitted cable seen through a lens whose distortion was left in, fitted again"
        ),
        BudgetLine(BLUR, blur_mm, "B", "the fitted cable blurred over five pixels, fitted again"),
    )
    given = (
        BudgetLine(SCALE, scale_std * 2 * fit.radius_mm, "B", "scale of the scanner as given"),
        BudgetLine(FILTER, filter_std_mm, "B", "left by the filter as given"),
    )
    return lines + tuple(line for line in (*found, *given) if line.std_mm > 0)


def combined(lines: Iterable[BudgetLine]) -> float:
    """Root of the sum of squares: the sources are independent."""
    return float(np.sqrt(sum(line.std_mm**2 for line in lines)))
