"""Whether points lie on one surface: not on two within each other, and not all through a solid."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.geometry.robust import robust_std
from cablejax.measure.fit.axis import locate
from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.shape.sections import BIN_DEG, bins_of

CELL_DEG = 20.0  # and half a radius along: a patch of the surface, within which walls have each their distance
CELL_POINTS = 8  # of a patch, for its points to be told apart
APART = 0.12  # of the variance of a patch that two levels leave: half of a Gaussian's points leave .36, of an even spread .25
MOST = 0.5  # of the points, that must lie in patches of two levels
EVEN = 0.1  # of the distance between the levels, that it and they may vary by: the levels of a coarse grid turn with the surface
LEAST_WALL = 0.01  # of the radius, between the levels: nearer ones are those of the coordinates' rounding
AROUND = 2.0  # radii from the axis, within which the points are looked at
SEEN = 0.3  # of the fullest direction's points, from which a direction counts
FILLED = (
    0.18  # of the surface's density, that its surroundings have in a solid (.24 to .6; about tree stems .12 at most)
)
LEAST_DEPTH = 0.02  # of the radius, either way: what counts as surface


class Walls(NamedTuple):
    """Two surfaces about one axis.

    Attributes:
        inner_mm, outer_mm: Their diameters.
        between_mm: Radius that parts them.
    """

    inner_mm: float
    outer_mm: float
    between_mm: float


def two_walls(fit: CableFit) -> Walls | None:
    """The two surfaces between which a fit lies, as the outside and the inside of a pipe; None where the points lie on one.

    Each patch of the surface has its points' distances from the axis cut in two where that leaves the least variance. An oval, a
    taper or a dent moves a patch as a whole and leaves its points together.

    Args:
        fit: The fit of axis and radius.
    """
    used = fit.weight > 0
    residual, place = fit.residual_mm[used], fit.place
    angle = np.degrees(np.arctan2(place.v[used], place.u[used])) % 360
    around = int(360 / CELL_DEG)
    along = np.floor((place.s[used] - place.s[used].min()) / (0.5 * fit.radius_mm)).astype(int)
    cell = along * around + np.minimum((angle / CELL_DEG).astype(int), around - 1)
    order = np.lexsort((residual, cell))
    residual, cell = residual[order], cell[order]
    _, first, number, count = np.unique(cell, return_index=True, return_inverse=True, return_counts=True)
    before = np.arange(len(cell)) - first[number] + 1.0  # points of the patch up to this one
    after = count[number] - before
    total = np.add.reduceat(residual, first)[number]
    running = np.cumsum(residual)
    lower = running - (running[first] - residual[first])[number]
    mean = total / count[number]
    variance = np.add.reduceat((residual - mean) ** 2, first) / count
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = lower / before, (total - lower) / after
        between = np.where(after > 0, before * after * (high - low) ** 2 / count[number] ** 2, 0.0)
    best = np.maximum.reduceat(between, first)
    two = (count >= CELL_POINTS) & (variance - best < APART * variance)
    if count[two].sum() <= MOST * len(cell):
        return None
    at = np.flatnonzero((between == best[number]) & two[number])
    low, high = fit.radius_mm + low[at], fit.radius_mm + high[at]
    inner, outer = float(np.median(low)), float(np.median(high))
    wall = outer - inner
    if wall < LEAST_WALL * fit.radius_mm or max(robust_std(low - inner), robust_std(high - low - wall)) > EVEN * wall:
        return None
    return Walls(2 * inner, 2 * outer, 0.5 * (inner + outer))


def filled(xyz: Float[np.ndarray, "n 3"], fit: CableFit) -> float | None:
    """How dense the points within and about a surface are beside its own, where that is as in a solid; None where it stands out.

    Args:
        xyz: All points of the scan, mm.
        fit: The fit of axis and radius.
    """
    radius, depth = fit.radius_mm, max(fit.noise_mm, LEAST_DEPTH * fit.radius_mm)
    box = AROUND * radius
    near = (xyz > fit.axis.xyz.min(axis=0) - box).all(axis=1) & (xyz < fit.axis.xyz.max(axis=0) + box).all(axis=1)
    place = locate(fit.axis, xyz[near])
    distance, bins = np.hypot(place.u, place.v), bins_of(np.arctan2(place.v, place.u))
    along, wall = (place.s > 0) & (place.s < fit.axis.length_mm), np.abs(distance - radius) < depth
    shown = np.bincount(bins[along & wall], minlength=int(360 / BIN_DEG))
    seen = along & (shown > SEEN * shown.max())[bins]
    inner, outer = max(radius - 2 * depth, 0.0), radius + 2 * depth
    about = (distance < inner) | ((distance > outer) & (distance < box))
    rest = float(np.sum(seen & about) / (inner**2 + box**2 - outer**2))
    on = float(np.sum(seen & wall) / (4 * radius * depth))
    return rest / max(on, 1e-12) if rest > FILLED * on else None
