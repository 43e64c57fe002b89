"""A scan measured twice, as it is and by the points that a network labels as the cable's; and which of the two is told."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from cablejax.measure.agree import alike
from cablejax.measure.errors import MeasureError
from cablejax.measure.messages import about_accessory, about_other_candidate
from cablejax.measure.result import CableMeasurement

ALONE = 0.9  # of the points: a cable that holds as many has nothing beside it that could be told apart
TRUSTED = 0.5  # of the points of the search's cable: with fewer labelled as a cable's, it is taken for something else

Measure = Callable[[Bool[np.ndarray, " n"] | None], CableMeasurement]


class PointLabels(NamedTuple):
    """What a network says of the points of a scan.

    Attributes:
        on_cable: Which it takes for a cable's `[n]`.
        on_accessory: Which it takes for a joint's, a stress cone's or a termination's `[n]`.
        diameter_mm: Least and greatest diameter of the cables that it has learnt from: others it cannot know.
    """

    on_cable: Bool[np.ndarray, " n"]
    on_accessory: Bool[np.ndarray, " n"]
    diameter_mm: tuple[float, float]


class LabelledMeasurement(NamedTuple):
    """Both candidates, and the one that is told.

    Attributes:
        result: The one that is told, with a warning that names the other where they disagree.
        by_search: Measured on all points.
        by_labels: Measured on the points labelled as a cable's; None where they are those of the search's cable, where that is
            refused, or where the network was not asked.
        taken: "search" or "labels".
    """

    result: CableMeasurement
    by_search: CableMeasurement
    by_labels: CableMeasurement | None
    taken: str


def decided(measure: Measure, label: Callable[[], PointLabels]) -> LabelledMeasurement:
    """Measure without and with labels, and decide.

    The search's cable stays where both agree, where most of its points are labelled as a cable's, where the labelled points
    are refused, or where what they show has a diameter that the network has never seen. Else the labels' is told. What the
    search refuses stays refused: labels find a cable in anything.

    Args:
        measure: Called with `on_cable`, None for all points.
        label: Gives the labels; not called where the search's cable holds `ALONE` of the points.

    Raises:
        MeasureError: If all points together show no cable that can be measured.
        ValueError: If there is not a label for each row.
    """
    search = measure(None)
    if search.keep.mean() >= ALONE:
        return LabelledMeasurement(search, search, None, "search")
    labels = label()
    for name in ("on_cable", "on_accessory"):
        given = getattr(labels, name)
        if np.shape(given) != search.keep.shape or given.dtype != bool:
            raise ValueError(f"labels.{name}: expected {len(search.keep)} truth values, got {list(np.shape(given))}")
    other = _by_labels(measure, search, labels)
    told, taken = search, "search"
    if other is not None and not alike(search, other):
        confirmed = float(labels.on_cable[search.keep].mean())
        low, high = labels.diameter_mm
        if confirmed < TRUSTED and low <= other.diameter_mm <= high:
            told, taken = other, "labels"
        left = search if taken == "labels" else other
        told = _warned(told, about_other_candidate(told.diameter_mm, left.diameter_mm, confirmed, taken=taken))
    on_accessory = float(labels.on_accessory[told.keep].mean())
    if on_accessory > TRUSTED:
        told = _warned(told, about_accessory(on_accessory))
    return LabelledMeasurement(told, search, other, taken)


def _by_labels(measure: Measure, search: CableMeasurement, labels: PointLabels) -> CableMeasurement | None:
    """The cable in the labelled points; None where they are the search's, none at all, or refused."""
    labelled = int(labels.on_cable.sum())
    if labelled == 0 or (labels.on_cable & search.keep).sum() >= ALONE * labelled:
        return None
    try:
        return measure(labels.on_cable)
    except MeasureError:
        return None


def _warned(told: CableMeasurement, warning: str) -> CableMeasurement:
    return replace(told, warnings=(*told.warnings, warning))
