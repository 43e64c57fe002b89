"""Steps, joints and dents: sections whose diameter leaves the local mean by more than it is known to."""

from typing import NamedTuple

import numpy as np

from cablejax.geometry.robust import robust_std
from cablejax.measure.shape.sections import Sections

NEIGHBORS = 8  # sections to either side that make the local mean
SIGMA = 5.0
LEAST_SHARE = 0.005  # of the diameter: less is no fault of a cable


class Irregularity(NamedTuple):
    """A run of sections off the local mean.

    Attributes:
        kind: "bulge", "dent", "step up" or "step down", along the axis.
        from_mm, to_mm: Where it lies along the axis.
        change_mm: By how much the diameter differs: at most within a bulge or dent, from before to after a step.
    """

    kind: str
    from_mm: float
    to_mm: float
    change_mm: float


def irregularities(sections: Sections) -> list[Irregularity]:
    """Runs of sections whose diameter differs from the median of their surroundings, and lasting changes of it.

    Sections known to worse than a hundredth of the diameter are passed over.
    """
    d, std, s = sections.diameter_mm, sections.std_mm, sections.s_mm
    good = np.isfinite(d) & (std < 0.01 * np.nanmedian(d))
    d, std, s = d[good], std[good], s[good]
    if len(d) < 2 * NEIGHBORS + 1:
        return []
    scatter = robust_std(np.diff(d)) / np.sqrt(2)
    doubt = SIGMA * np.hypot(std, scatter) + LEAST_SHARE * np.median(d)
    before = np.array([np.median(d[max(0, i - NEIGHBORS) : max(i, 1)]) for i in range(len(d))])
    after = np.array([np.median(d[i : i + NEIGHBORS]) for i in range(len(d))])
    jump = np.where((np.arange(len(d)) >= 3) & (np.arange(len(d)) < len(d) - 3), after - before, 0.0)
    out = []
    for low, high in _runs(np.abs(jump) > doubt):
        top = low + int(np.argmax(np.abs(jump[low:high])))
        kind = "step up" if jump[top] > 0 else "step down"
        out.append(Irregularity(kind, float(s[max(top - 1, 0)]), float(s[top]), float(jump[top])))
    steps = np.array([0.5 * (one.from_mm + one.to_mm) for one in out])
    level = np.array([np.median(d[max(0, i - NEIGHBORS) : i + NEIGHBORS + 1]) for i in range(len(d))])
    for low, high in _runs(np.abs(d - level) > doubt):
        top = low + int(np.argmax(np.abs(d - level)[low:high]))
        width = NEIGHBORS * float(np.median(np.diff(s)))
        if len(steps) == 0 or np.abs(steps - s[top]).min() > width:
            change = float(d[top] - level[top])
            out.append(Irregularity("bulge" if change > 0 else "dent", float(s[low]), float(s[high - 1]), change))
    return sorted(out, key=lambda one: one.from_mm)


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """First row of each run of True, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(low), int(high)) for low, high in edges.reshape(-1, 2)]
