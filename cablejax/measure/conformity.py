"""Measured values against limits: pass, fail, or undecided where the uncertainty does not allow to say (JCGM 106)."""

import math

SURE = 0.95
BEND_DIAMETERS = (12, 15, 20)  # least bend radii of IEC and makers, in overall diameters


def _below(limit: float, value: float, std: float) -> float:
    return 0.5 * math.erfc((value - limit) / (std * math.sqrt(2)))


def conformity(value: float | int, std: float | int, *, low: float | int, high: float | int) -> str:
    """ "pass" where the value lies within the limits with a probability of 95 %, "fail" likewise, else "undecided".

    Args:
        value: Measured.
        std: Its standard uncertainty, normal.
        low, high: Limits in the same unit; infinite where there is none.

    Raises:
        ValueError: If `low` is not below `high` or `std` is not positive.

    Example:
        >>> [conformity(d, 0.05, low=29.5, high=30.5) for d in (30.0, 30.48, 30.7)]
        ['pass', 'undecided', 'fail']
    """
    if not low < high:
        raise ValueError(f"low: expected less than high, {high:g}, got {low:g}")
    if not std > 0:
        raise ValueError(f"std: expected a positive number, got {std}")
    within = _below(high, value, std) - _below(low, value, std)
    return "pass" if within >= SURE else "fail" if within <= 1 - SURE else "undecided"


def bend_conformity(
    bend_interval_mm: tuple[float, float] | list[float] | None, diameter_mm: float | int
) -> dict[str, str]:
    """The least bend radius against 12, 15 and 20 overall diameters: by its 95 % interval; a straight cable passes.

    Example:
        >>> bend_conformity((400.0, 440.0), 30.0)
        {'12 D': 'pass', '15 D': 'fail', '20 D': 'fail'}
    """
    out = {}
    for factor in BEND_DIAMETERS:
        least = factor * diameter_mm
        if bend_interval_mm is None or bend_interval_mm[0] >= least:
            out[f"{factor} D"] = "pass"
        else:
            out[f"{factor} D"] = "fail" if bend_interval_mm[1] < least else "undecided"
    return out
