"""Where the round thing ends: the stretch of its length over which the scan shows it.

Beyond a free end, or where a cable goes into a housing, a fitted tube still brushes past other things. It shows in the
arc: single sections there hold a part of what the thing itself shows.
"""

import numpy as np
from jaxtyping import Bool, Float

from cablejax.measure.shape.sections import BIN_DEG, bins_of

LEAST_ARC = 0.7  # of the usual arc, which half of the points lie in slabs of
SMALL_GAP = 3  # bins to either side: gaps up to twice as wide may be chance, where points are few
PER_SLAB = 60  # points, on average, that a slab must hold for its arc to be counted
SLABS = 200


def extent(along: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"], *, radius_mm: float) -> tuple[float, float]:
    """First and last arc length of the stretch that shows its circumference.

    Slabs half a radius long count where their arc is at least `LEAST_ARC` of the usual one. The run of such slabs with
    the most points is kept, and neighbouring ones across gaps that are shorter than they are: a tie or a bracket hides
    a cable for a while, but a thing that begins again for less than the gap is another thing.

    Args:
        along: Arc length of the points on the surface, mm.
        angle: Their angle about the axis, radians.
        radius_mm: Radius of the surface.
    """
    low, length = float(along.min()), float(np.ptp(along))
    width = max(0.5 * radius_mm, length / SLABS, length * PER_SLAB / len(along))
    count = max(1, int(length / width))
    slab = np.minimum(((along - low) / max(length, 1e-9) * count).astype(int), count - 1)
    covered = np.zeros((count, int(360 / BIN_DEG)), dtype=bool)
    covered[slab, bins_of(angle)] = True
    points = np.bincount(slab, minlength=count).astype(float)
    arc = _closed(covered, points).sum(axis=1)
    order = np.argsort(arc, kind="stable")
    usual = arc[order][np.searchsorted(np.cumsum(points[order]), 0.5 * len(along))]
    first, last = joined(arc >= LEAST_ARC * usual, points)
    inside = along[(slab >= first) & (slab <= last)]
    return float(inside.min()), float(inside.max())


def _closed(covered: Bool[np.ndarray, "m bins"], points: Float[np.ndarray, " m"]) -> Bool[np.ndarray, "m bins"]:
    """Rows of bins around the circumference without gaps that chance leaves: a thin slab shows as much arc as a dense one.

    Of so many points to a bin, gaps wider than `2 half` bins are expected less than once a circumference.
    """
    closed = [_without_gaps(covered, half) for half in range(SMALL_GAP + 1)]
    density = points / np.maximum(closed[-1].sum(axis=1), 1)
    half = np.minimum(0.5 * np.log(covered.shape[1]) / np.maximum(density, 1e-9), SMALL_GAP).astype(int)
    return np.stack(closed)[half, np.arange(len(covered))]


def _without_gaps(covered: Bool[np.ndarray, "m bins"], half: int) -> Bool[np.ndarray, "m bins"]:
    """Rows of bins without gaps of up to `2 half` bins."""
    shifts = range(-half, half + 1)
    wider = np.any([np.roll(covered, shift, axis=1) for shift in shifts], axis=0)
    return np.all([np.roll(wider, shift, axis=1) for shift in shifts], axis=0)


def joined(shown: Bool[np.ndarray, " m"], points: Float[np.ndarray, " m"]) -> tuple[int, int]:
    """First and last slab of the run with the most points, joined with runs beyond gaps shorter than they are.

    Example:
        >>> one = np.array([1, 1, 1, 1, 0, 1, 1, 0, 0, 0, 1], dtype=bool)
        >>> joined(one, np.ones(11))
        (0, 6)
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], shown.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    most = int(np.argmax([points[low:high].sum() for low, high in runs]))
    first, last = runs[most]
    for low, high in runs[most + 1 :]:
        if low - last > high - low:
            break
        last = high
    for low, high in runs[:most][::-1]:
        if first - high > high - low:
            break
        first = low
    return int(first), int(last) - 1
