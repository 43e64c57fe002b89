"""Where the fit to all points begins: axis, radius and reach, from a few thousand of the points."""

from typing import NamedTuple

import numpy as np

from cablejax.geometry.principal import principal_axes
from cablejax.measure.errors import MeasureError, NoCableError
from cablejax.measure.find.planes import Plane
from cablejax.measure.find.track import Track
from cablejax.measure.fit.axis import Axis, locate, sampled, smoothed, trimmed, turns_by
from cablejax.measure.fit.least_squares import CableFit, fit_cable
from cablejax.measure.shape.ends import extent

MIN_ON_CABLE = 30
KNOTS = 1.0  # diameters between knots of an axis that bends
COARSE_POINTS = 8_000  # on which the first fits are made
SHORTEST = (
    0.05  # radii: coordinates written with few digits lie in planes, one of which may alone show its circumference
)
SHARPEST = np.radians(60.0)  # within one diameter: a bend radius of .95 diameters


class Start(NamedTuple):
    """Where the fit to all points begins: axis, radius, reach about the surface, noise, and diameters between knots."""

    axis: Axis
    radius: float
    width: float
    noise: float
    knots: float


def coarse_start(xyz: np.ndarray, track: Track, planes: list[Plane]) -> Start:
    """A start from a few thousand of the points, about a straight axis unless they are better explained by a bent one.

    Raises:
        MeasureError: If too few lie on the cable.
    """
    xyz = xyz[:: max(1, len(xyz) // COARSE_POINTS)]
    radius = track.radius_mm
    if (line := _line(track)) is not None:
        try:
            straight = _cut(xyz, line, radius, planes, knots=np.inf)
            if not _bends(xyz, straight, planes):
                return straight
        except MeasureError:  # there is no straight thing: it may bend
            pass
    axis = smoothed(track.axis, knot_mm=4 * radius, step=0.2 * radius, extend_mm=2 * radius)
    return _cut(xyz, axis, radius, planes, knots=KNOTS)


def _line(track: Track) -> Axis | None:
    """The straight line along a track, a diameter longer at either end; None where the track leaves it by half a radius."""
    middle, axes, _ = principal_axes(track.axis)
    direction = axes[0]
    along = (track.axis - middle) @ direction
    aside = np.linalg.norm(track.axis - middle - along[:, None] * direction, axis=1)
    if aside.max() > 0.5 * track.radius_mm:
        return None
    ends = np.array([along.min() - 2 * track.radius_mm, along.max() + 2 * track.radius_mm])
    return sampled(middle + ends[:, None] * direction, step=0.2 * track.radius_mm)


def _bends(xyz: np.ndarray, straight: Start, planes: list[Plane]) -> bool:
    """Whether an axis free to bend explains the points better than the straight one, by more than its knots may by chance.

    Schwarz's criterion on the sums of squares, cut off at three standard deviations; correlated points count for
    fewer, in the ratio of the radius's variances.
    """
    rows, _ = tube(straight.axis, straight.radius, xyz, planes, straight.width, beyond=0.0)
    line = fit_cable(xyz[rows], straight.axis, straight.radius, knot_diameters=np.inf)
    try:
        curve = fit_cable(xyz[rows], line.axis, line.radius_mm, knot_diameters=KNOTS)
    except MeasureError:
        return False
    limit = (3 * curve.noise_mm) ** 2
    gain = np.minimum(line.residual_mm**2, limit).sum() - np.minimum(curve.residual_mm**2, limit).sum()
    points = len(rows) * (curve.random_mm / max(curve.clustered_mm, curve.random_mm)) ** 2
    knots = 2 * int(curve.axis.length_mm / (2 * curve.radius_mm * KNOTS))
    scale = np.minimum(curve.residual_mm**2, limit).mean()
    return bool(gain / scale * points / len(rows) > knots * np.log(max(points, 3.0)))


def _cut(xyz: np.ndarray, axis: Axis, radius: float, planes: list[Plane], *, knots: float) -> Start:
    """Fit and cut the tube in turn: a start that is 10 % off cuts it on one side."""
    previous, width, noise = np.empty(0, dtype=int), 0.3 * radius, 0.0
    for _ in range(3):
        rows, _ = tube(axis, radius, xyz, planes, width, beyond=radius)
        if np.array_equal(previous, rows):
            break
        fit = fit_cable(xyz[rows], axis, radius, knot_diameters=knots)
        axis, radius, previous = trimmed(fit.axis, *seen(fit)), fit.radius_mm, rows
        noise = fit.noise_mm
        width = float(np.clip(4.5 * noise, 0.3 * radius, 0.8 * radius))
    return Start(axis, radius, width, noise, knots)


def seen(fit: CableFit) -> tuple[float, float]:
    """The stretch of a fit's length that shows the thing it was fitted to, and does not turn as no cable does.

    Where an axis turns by more than `SHARPEST` within a diameter, its bend radius is below a diameter: past its end a curve
    follows whatever comes. Of the stretches between such places the one with the most points counts.

    Raises:
        MeasureError: If the stretch is a ring, on whose plane no direction of an axis rests.
    """
    used = fit.weight > 0
    angle = np.arctan2(fit.place.v[used], fit.place.u[used])
    along = fit.place.s[used]
    calm = turns_by(fit.axis, 2 * fit.radius_mm) <= SHARPEST
    if calm.any() and not calm.all():
        edges = np.flatnonzero(np.diff(np.concatenate([[0], calm.astype(int), [0]]))).reshape(-1, 2)
        runs = [(along >= fit.axis.s[first]) & (along <= fit.axis.s[last - 1]) for first, last in edges]
        longest = max(runs, key=np.count_nonzero)
        if longest.sum() >= MIN_ON_CABLE:
            along, angle = along[longest], angle[longest]
    low, high = extent(along, angle, radius_mm=fit.radius_mm)
    if high - low < SHORTEST * fit.radius_mm:
        raise NoCableError(
            f"No cable found: what is roundest, some {2 * fit.radius_mm:.3g} mm across, is a ring {high - low:.3g} mm long."
        )
    return low, high


def tube(
    axis: Axis, radius: float, xyz: np.ndarray, planes: list[Plane], width: float, *, beyond: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows within `width` of the surface, off the planes, and no further than `beyond` past the ends; their arc length.

    Raises:
        MeasureError: If there are too few.
    """
    box = (xyz > axis.xyz.min(axis=0) - 2 * radius).all(axis=1) & (xyz < axis.xyz.max(axis=0) + 2 * radius).all(axis=1)
    rows = np.flatnonzero(box)
    for plane in planes:
        rows = rows[~plane.holds(xyz[rows])]
    place = locate(axis, xyz[rows])
    distance = np.hypot(place.u, place.v)
    inside = (place.s > -beyond) & (place.s < axis.s[-1] + beyond) & (np.abs(distance - radius) < width)
    if inside.sum() < MIN_ON_CABLE:
        raise NoCableError(f"Too few points on the cable: {inside.sum()} where at least {MIN_ON_CABLE} are needed.")
    return rows[inside], place.s[inside]
