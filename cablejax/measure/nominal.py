"""Which nominal size a measured diameter means, in probabilities, and whether that can be told at all."""

from collections.abc import Mapping

import numpy as np

SURE = 0.95


def nominal_probabilities(diameter_mm: float, std_mm: float, catalogue: Mapping[str, float]) -> dict[str, float]:
    """Probability of each nominal size, all equally likely before the measurement, likeliest first.

    Args:
        diameter_mm: Measured diameter.
        std_mm: Its standard uncertainty, with whatever tolerance the makers keep.
        catalogue: Overall diameter in mm of each size, by name.

    Raises:
        ValueError: If the catalogue is empty or `std_mm` is not positive.

    Example:
        >>> nominal_probabilities(30.0, 0.5, {"95": 27.9, "120": 29.5, "150": 31.0})["120"] > 0.8
        True
    """
    if not catalogue:
        raise ValueError("catalogue: expected at least one size, got none")
    if not std_mm > 0:
        raise ValueError(f"std_mm: expected a positive number, got {std_mm}")
    names = list(catalogue)
    log = -0.5 * ((np.array([catalogue[name] for name in names]) - diameter_mm) / std_mm) ** 2
    weight = np.exp(log - log.max())
    order = np.argsort(-weight, kind="stable")
    return {names[i]: float(weight[i] / weight.sum()) for i in order}


def verdict(
    probabilities: Mapping[str, float], diameter_mm: float, std_mm: float, catalogue: Mapping[str, float]
) -> str:
    """The size in words: its name, "cannot tell" between neighbours, or that no size of the catalogue is near.

    Example:
        >>> sizes = {"120": 29.5, "150": 31.0}
        >>> verdict({"120": 0.6, "150": 0.4}, 30.2, 0.5, sizes)
        'cannot tell: 120 (60 %) or 150 (40 %)'
    """
    best = next(iter(probabilities))
    gap = sorted(catalogue.values())
    apart = float(np.min(np.diff(gap))) if len(gap) > 1 else gap[0]
    if abs(catalogue[best] - diameter_mm) > max(3 * std_mm, 0.5 * apart + 3 * std_mm):
        return f"none: the nearest, {best}, has {catalogue[best]:.2f} mm"
    if probabilities[best] >= SURE:
        return best
    likely = [f"{name} ({100 * p:.0f} %)" for name, p in probabilities.items() if p >= 0.05]
    return "cannot tell: " + " or ".join(likely)
