"""Searches with different random samples that must agree: what only one of them finds in clutter is made up."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cablejax.geometry.robust import COVERAGE
from cablejax.measure.errors import MeasureError, NoCableError
from cablejax.measure.messages import about_one_find, about_other_find, found_once
from cablejax.measure.result import CableMeasurement

CLEAR = 0.5  # of the scan's points: a cable that holds more of them is not found by chance
NEAR = 0.5  # radii between the axes of what is the same thing
ALIKE = 0.02  # of the diameter, by which two fits to the same thing may differ whatever their intervals


def confirmed(first: CableMeasurement, search: Callable[[int], CableMeasurement], seed: int) -> CableMeasurement:
    """The first result if one of two further searches finds it as well.

    Where they find something else, the one with more points is returned with a warning, which there is also where they find
    something that cannot be measured.

    Args:
        first: What the search with `seed` found.
        search: Searches with another seed.
        seed: Of the first search.

    Raises:
        MeasureError: If neither of the others finds anything round.
    """
    others, nothing = [], 0
    for number in (1, 2):
        try:
            others.append(search(seed + number))
        except NoCableError:
            nothing += 1
            continue
        except MeasureError:  # something round, that could not be measured
            continue
        if alike(first, others[-1]):
            return first
    if nothing == 2:
        raise found_once(first.diameter_mm)
    if not others:
        return replace(first, warnings=(*first.warnings, about_one_find(first.diameter_mm)))
    best, *rest = sorted([first, *others], key=lambda one: -one.points)
    return replace(best, warnings=(*best.warnings, about_other_find(best.diameter_mm, rest[0].diameter_mm)))


def alike(one: CableMeasurement, other: CableMeasurement) -> bool:
    """Whether two measurements are of the same thing: diameters within their intervals, axes that run together."""
    allowed = max(COVERAGE * float(np.hypot(one.std_mm, other.std_mm)), ALIKE * one.diameter_mm)
    middle = other.axis_mm[len(other.axis_mm) // 2]
    apart = np.linalg.norm(one.axis_mm - middle, axis=1).min()
    return bool(abs(one.diameter_mm - other.diameter_mm) <= allowed and apart < NEAR * one.diameter_mm / 2)
