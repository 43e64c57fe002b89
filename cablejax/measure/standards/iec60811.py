"""Overall diameters as IEC 60811-203 has them read: across twice up to 25 mm, round the circumference above."""

import math
from typing import NamedTuple

LARGE_MM = 25.0  # above, the diameter is that of the circumference
FINE_MM, COARSE_MM = 0.1, 0.5  # steps of the readings below and above


class Readings(NamedTuple):
    """Readings of an overall diameter, and the verdict on them.

    Attributes:
        method: "two perpendicular", "circumference", or "one diameter" where too little of the circumference was seen for
            two.
        readings_mm: Each as it is written down, rounded.
        mean_mm: Their mean, rounded to the same step.
        step_mm: That step.
        verdict: "pass" or "fail" of the mean against the limits; None without limits. How sure that is, the rounding
            hides: `cablejax.measure.conformity` says.
    """

    method: str
    readings_mm: tuple[float, ...]
    mean_mm: float
    step_mm: float
    verdict: str | None


def readings(
    diameter_mm: float,
    *,
    across_mm: tuple[float, float] | None = None,
    limits_mm: tuple[float, float] | None = None,
) -> Readings:
    """Read a diameter as with a micrometer or a tape.

    Args:
        diameter_mm: Diameter by the perimeter.
        across_mm: Two widths square to each other, the greatest one of them; None where they are not known.
        limits_mm: Least and greatest diameter allowed, both included.

    Raises:
        ValueError: If a length is not positive, or the limits are not in order.

    Example:
        >>> readings(21.234, across_mm=(21.47, 21.01), limits_mm=(20.8, 21.6))
        Readings(method='two perpendicular', readings_mm=(21.5, 21.0), mean_mm=21.3, step_mm=0.1, verdict='pass')
        >>> readings(34.21).readings_mm
        (34.0,)
    """
    lengths = (diameter_mm, *(across_mm or ()))
    if not all(math.isfinite(length) and length > 0 for length in lengths):
        raise ValueError(f"diameter_mm, across_mm: expected positive numbers, got {lengths}")
    if limits_mm is not None and not limits_mm[0] < limits_mm[1]:
        raise ValueError(f"limits_mm: expected the lower one first, got {limits_mm}")
    if diameter_mm > LARGE_MM:
        method, step, found = "circumference", COARSE_MM, (diameter_mm,)
    elif across_mm is None:
        method, step, found = "one diameter", FINE_MM, (diameter_mm,)
    else:
        method, step, found = "two perpendicular", FINE_MM, across_mm
    written = tuple(rounded(value, step) for value in found)
    mean = rounded(math.fsum(written) / len(written), step)
    verdict = None
    if limits_mm is not None:
        verdict = "pass" if limits_mm[0] <= mean <= limits_mm[1] else "fail"
    return Readings(method, written, mean, step, verdict)


def rounded(value: float, step: float) -> float:
    """The nearest multiple of a step; of two as near, the greater (ISO 80000-1, rule B).

    Example:
        >>> [rounded(v, 0.1) for v in (21.25, 21.349, 21.35)], rounded(34.25, 0.5)
        ([21.3, 21.3, 21.4], 34.5)
    """
    # A decimal that ends in 5 may lie a hair below in binary.
    return round(math.floor(value / step + 0.5 + 1e-9) * step, 6)
