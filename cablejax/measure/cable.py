"""From a scan to a diameter: find the cable, fit its axis and radius, and say how well each number is known."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from cablejax.measure.advice import (
    SHIFTED,
    about_instrument,
    arc_too_small,
    arc_too_small_for_errors,
    check_cloud,
    check_labels,
    not_found_again,
    not_one_surface,
    not_round,
    nothing_found,
    strayed,
    too_flat,
    too_rough,
    unknown_diameter,
    warnings_about,
)
from cablejax.measure.alignment import Profile, blocks, shared_errors
from cablejax.measure.axis import Axis, locate, sampled, smoothed, trimmed
from cablejax.measure.beams import BeamBias, Instrument, beam_bias, clear_of_the_rim, known_beam_bias, rescanned
from cablejax.measure.bend import tightest_bend
from cablejax.measure.budget import COVERAGE, combined, uncertainty_budget, unseen_errors
from cablejax.measure.candidates import Find, find_cables
from cablejax.measure.ends import extent
from cablejax.measure.errors import MeasureError
from cablejax.measure.fit import CableFit, fit_cable
from cablejax.measure.freeform import free_section
from cablejax.measure.nominal import nominal_probabilities, verdict
from cablejax.measure.planes import Plane
from cablejax.measure.result import CableMeasurement
from cablejax.measure.sections import Oval, Sections, arc_seen, cut, oval
from cablejax.measure.structure import flat_faces, shared_mm
from cablejax.measure.sweeps import at_the_edge, sweeps_of
from cablejax.measure.walk import Walk
from cablejax.types import PointCloud

MIN_ON_CABLE = 30
WORST_STD = 0.25  # of the diameter: beyond, the interval reaches from less than half of it to more than one and a half
SHARED_ARC_DEG = 65.0  # with errors that neighbours share, an arc below tells nothing unless the scanner is known
LEAST_OPEN = 0.02  # of the radius, that they must leave open to matter: scans without noise share micrometres
SHARED_MOST = 0.5  # of the scatter: shared errors above are the scanner's own, and not its noise
KNOTS = 1.0  # diameters between knots of an axis that bends
COARSE_POINTS = 8_000  # on which the first fits are made
PER_SECTION = 40  # points, on average, that a section must hold at least
ROUGHEST = 0.33  # scatter over the radius; points that fill a cylinder evenly scatter by .35 of their mean distance
KNOWN_STEEP = 30.0  # s^3 / R^2: what a known scanner's correction leaves open, as found on simulated scans
ROUGHEST_SHARED = 0.1  # of the radius: neighbouring points that leave the circle together by more lie on something else
KEEP_SIGMA = 3.5  # standard deviations from the surface within which a point counts as the cable's


@dataclass(frozen=True)
class MeasureSettings:
    """How a cable is sought and judged.

    Attributes:
        min_arc_deg: Least circumference that must be seen; below it the diameter is not reported.
        oval_arc_deg: Least circumference on which ovality is reported.
        section_mm: Distance between sections; a quarter of the diameter if None, and at most 200 sections.
        registration_std_mm: Standard deviation of the stations' alignment, for the budget.
        scale_std: Relative standard deviation of the scanner's scale, for the budget.
        filter_std_mm: Standard deviation that a filter applied before has left in the diameter, for the budget.
        maker_std_mm: Standard deviation of the makers' diameters about the catalogue's, for the nominal size.
        instrument: The scanner's noise and beam, by which their effects on the diameter are taken off more exactly.
        seed: Of the random samples with which the cable is sought.
    """

    min_arc_deg: float = 40.0
    oval_arc_deg: float = 175.0
    section_mm: float | None = None
    registration_std_mm: float = 0.0
    scale_std: float = 0.0
    filter_std_mm: float = 0.0
    maker_std_mm: float = 0.0
    instrument: Instrument | None = None
    seed: int = 0


def _points(cloud_or_xyz_mm: PointCloud | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All points in float64, and which of them are points at all: padding and NaN are not."""
    if isinstance(cloud_or_xyz_mm, PointCloud):
        xyz = np.asarray(cloud_or_xyz_mm.xyz, dtype=np.float64)
        valid = np.array(cloud_or_xyz_mm.mask)
    else:
        xyz = np.asarray(cloud_or_xyz_mm, dtype=np.float64)
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise ValueError(f"cloud_or_xyz_mm: expected shape [n, 3], got {list(xyz.shape)}")
        valid = np.ones(len(xyz), dtype=bool)
    return xyz, valid & np.isfinite(xyz).all(axis=1)


def _tube(
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
        raise MeasureError(f"Too few points on the cable: {inside.sum()} where at least {MIN_ON_CABLE} are needed.")
    return rows[inside], place.s[inside]


class _Start(NamedTuple):
    """Where the fit to all points begins: axis, radius, reach about the surface, noise, and diameters between knots."""

    axis: Axis
    radius: float
    width: float
    noise: float
    knots: float


def _coarse(xyz: np.ndarray, way: Walk, planes: list[Plane]) -> _Start:
    """A start from a few thousand of the points, about a straight axis unless they are better explained by a bent one.

    Raises:
        MeasureError: If too few lie on the cable.
    """
    xyz = xyz[:: max(1, len(xyz) // COARSE_POINTS)]
    radius = way.radius_mm
    if (line := _line(way)) is not None:
        try:
            straight = _cut(xyz, line, radius, planes, knots=np.inf)
            if not _bends(xyz, straight, planes):
                return straight
        except MeasureError:  # there is no straight thing: it may bend
            pass
    axis = smoothed(way.axis, knot_mm=4 * radius, step=0.2 * radius, extend_mm=2 * radius)
    return _cut(xyz, axis, radius, planes, knots=KNOTS)


def _line(way: Walk) -> Axis | None:
    """The straight line along a walk, a diameter longer at either end; None where the walk leaves it by half a radius."""
    middle = way.axis.mean(axis=0)
    direction = np.linalg.svd(way.axis - middle, full_matrices=False)[2][0]
    along = (way.axis - middle) @ direction
    aside = np.linalg.norm(way.axis - middle - along[:, None] * direction, axis=1)
    if aside.max() > 0.5 * way.radius_mm:
        return None
    ends = np.array([along.min() - 2 * way.radius_mm, along.max() + 2 * way.radius_mm])
    return sampled(middle + ends[:, None] * direction, step=0.2 * way.radius_mm)


def _bends(xyz: np.ndarray, straight: _Start, planes: list[Plane]) -> bool:
    """Whether an axis free to bend explains the points better than the straight one, by more than its knots may by chance.

    Schwarz's criterion on the sums of squares, cut off at three standard deviations; points that hang together count for
    fewer, in the ratio of the radius's variances.
    """
    rows, _ = _tube(straight.axis, straight.radius, xyz, planes, straight.width, beyond=0.0)
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


def _cut(xyz: np.ndarray, axis: Axis, radius: float, planes: list[Plane], *, knots: float) -> _Start:
    """Fit and cut the tube in turn: a start that is 10 % off cuts it on one side."""
    previous, width, noise = np.empty(0, dtype=int), 0.3 * radius, 0.0
    for _ in range(3):
        rows, _ = _tube(axis, radius, xyz, planes, width, beyond=radius)
        if np.array_equal(previous, rows):
            break
        fit = fit_cable(xyz[rows], axis, radius, knot_diameters=knots)
        axis, radius, previous = trimmed(fit.axis, *_seen(fit)), fit.radius_mm, rows
        noise = fit.noise_mm
        width = float(np.clip(4.5 * noise, 0.3 * radius, 0.8 * radius))
    return _Start(axis, radius, width, noise, knots)


def _seen(fit: CableFit) -> tuple[float, float]:
    """The stretch of a fit's length that shows the thing it was fitted to."""
    used = fit.weight > 0
    angle = np.arctan2(fit.place.v[used], fit.place.u[used])
    return extent(fit.place.s[used], angle, radius_mm=fit.radius_mm)


class _Fitted(NamedTuple):
    """The fit, the rows that took part, the sweep of each if the sweeps are known, and where along the start they lay."""

    fit: CableFit
    rows: np.ndarray
    sweep: np.ndarray | None
    along: np.ndarray
    knots: float


def _fit(
    xyz: np.ndarray, station: np.ndarray | None, way: Walk, planes: list[Plane], instrument: Instrument | None
) -> _Fitted:
    """Fit axis and radius to the full cloud about a walk, with a shift for every sweep that is known."""
    start = _coarse(xyz, way, planes)
    rows, along = _tube(start.axis, start.radius, xyz, planes, start.width, beyond=start.radius)
    fit, sweep = _with_sweeps(xyz, station, rows, along, start, instrument)
    low, high = _seen(fit)
    inside = (fit.place.s >= low) & (fit.place.s <= high)
    if not inside[fit.weight > 0].all():  # the coarse fit's ends are those of its few points
        if inside.sum() < MIN_ON_CABLE:
            raise MeasureError(f"Too few points on the cable: {inside.sum()} where at least {MIN_ON_CABLE} are needed.")
        rows, along = rows[inside], along[inside]
        start = start._replace(axis=trimmed(fit.axis, low, high), radius=fit.radius_mm)
        fit, sweep = _with_sweeps(xyz, station, rows, along, start, instrument)
    return _Fitted(fit, rows, sweep, along, start.knots)


def _with_sweeps(
    xyz: np.ndarray,
    station: np.ndarray | None,
    rows: np.ndarray,
    along: np.ndarray,
    start: _Start,
    instrument: Instrument | None,
) -> tuple[CableFit, np.ndarray | None]:
    """The fit to some rows, and the sweep of each if the sweeps are known."""
    sweep = sweeps_of(along)
    if station is not None:
        named = np.unique(station[rows], return_inverse=True)[1].reshape(-1)
        both = named if sweep is None else named * (sweep.max() + 1) + sweep
        sweep = np.unique(both, return_inverse=True)[1].reshape(-1)
    fit = _about(xyz[rows], start.axis, start.radius, start.noise, sweep, along, instrument, start.knots)
    return fit, sweep


def _about(
    xyz: np.ndarray,
    axis: Axis,
    radius: float,
    noise: float,
    sweep: np.ndarray | None,
    along: np.ndarray,
    instrument: Instrument | None,
    knots: float,
) -> CableFit:
    """The fit about a start, with a shift for every sweep that is known and without the edges of what it saw."""
    place = locate(axis, xyz)
    trust = ~at_the_edge(place, sweep, noise_mm=noise, radius_mm=radius)
    if instrument is not None:
        trust &= clear_of_the_rim(place, sweep, radius_mm=radius, instrument=instrument)
    if sweep is None or sweep.max() == 0:
        return fit_cable(xyz, axis, radius, trust=trust, knot_diameters=knots)
    pieces = max(1, min(8, len(xyz) // (500 * int(sweep.max() + 1))))
    block = blocks(sweep, along, pieces=pieces)
    return fit_cable(xyz, axis, radius, block=block, trust=trust, knot_diameters=knots)


def _beams(fitted: _Fitted, settings: MeasureSettings) -> BeamBias:
    """What the beams have done to the diameter, by the scanner's own numbers where they are given.

    Raises:
        MeasureError: If by these numbers the scanner would not have seen the cable that was found.
    """
    known = None
    if settings.instrument is not None:
        try:
            rng = np.random.default_rng(settings.seed)
            known = known_beam_bias(fitted.fit, fitted.sweep, settings.instrument, _refit(fitted, settings), rng)
        except MeasureError as error:
            raise not_found_again(str(error), known=True) from None
    return beam_bias(fitted.fit, fitted.sweep) if known is None else known


def _refit(fitted: _Fitted, settings: MeasureSettings) -> Callable[[np.ndarray, np.ndarray], CableFit]:
    """What fits points that stand for some rows of those that were fitted, in the same way."""
    fit, sweep = fitted.fit, fitted.sweep

    def refit(xyz: np.ndarray, rows: np.ndarray) -> CableFit:
        named = None if sweep is None else np.unique(sweep[rows], return_inverse=True)[1].reshape(-1)
        start = (fit.axis, fit.radius_mm, fit.noise_mm)
        return _about(xyz, *start, named, fitted.along[rows], settings.instrument, fitted.knots)

    return refit


def _higher(fitted: _Fitted, beam: BeamBias, settings: MeasureSettings) -> float:
    """By how much the formula for the noise's effect on the diameter is wrong, where it was used.

    Raises:
        MeasureError: If with its noise put on anew the fitted cable cannot be fitted again.
    """
    if beam.excess is not None:
        return KNOWN_STEEP * fitted.fit.noise_mm**3 / fitted.fit.radius_mm**2
    rng = np.random.default_rng(settings.seed)
    try:
        return abs(rescanned(fitted.fit, fitted.sweep, _refit(fitted, settings), rng) - beam.bias_mm)
    except MeasureError as error:
        raise not_found_again(str(error), known=False) from None


def _best(
    xyz: np.ndarray, station: np.ndarray | None, find: Find, settings: MeasureSettings
) -> tuple[_Fitted, Sections, float]:
    """Fit the walks in turn until one shows enough of its circumference; the first one's failure if none does.

    Raises:
        MeasureError: That failure.
    """
    failure: MeasureError | None = None
    for way in find.walks:
        try:
            fitted = _fit(xyz, station, way, find.planes, settings.instrument)
        except MeasureError as error:  # nothing round there; where most is flat, that is the reason to give
            failure = failure or (nothing_found(find) if find.flat_share > 0.5 else error)
            continue
        # Lesser finds of such a scan are no better, and one of them may fit something else very well.
        if (error := strayed(way.radius_mm, fitted.fit.radius_mm)) is not None:
            raise failure or error
        if fitted.fit.noise_mm > ROUGHEST * fitted.fit.radius_mm:
            failure = failure or too_rough(fitted.fit.noise_mm, fitted.fit.radius_mm)
            continue
        sections = _sections(fitted.fit, settings)
        arc = arc_seen(fitted.fit, sections)
        if arc < settings.min_arc_deg:
            failure = failure or arc_too_small(arc, settings.min_arc_deg, find)
            continue
        faces = flat_faces(fitted.fit, arc)
        if faces is not None:
            failure = failure or not_round(faces, 2 * fitted.fit.radius_mm)
            continue
        return fitted, sections, arc
    raise failure or nothing_found(find)


def _sections(fit: CableFit, settings: MeasureSettings) -> Sections:
    used = fit.place.s[fit.weight > 0]
    length = float(np.ptp(used))
    step = settings.section_mm if settings.section_mm is not None else 0.5 * fit.radius_mm
    # On a coarse grid a short section holds two points, which show no arc.
    return cut(fit, step_mm=max(step, length / 200, length * PER_SECTION / len(used)))


def _headline(fit: CableFit, shape: Oval | None, profile: Profile | None, bias_mm: float) -> float:
    """The diameter reported: of the circle, or of an oval much larger than the errors that directions share.

    What the beams have done to it is taken off, and from a circle what the directions' errors have most likely done to it.
    """
    shared, change = (0.0, 0.0) if profile is None else (profile.shared_mm, profile.change_mm)
    unsure = 0.0 if shape is None else max(shape.amplitude_std_mm, 4 * shared)
    certain = shape is not None and shape.maximum_mm - shape.minimum_mm > 4 * unsure
    mean = shape.diameter_mm if shape is not None and certain else 2 * (fit.radius_mm + change)
    return mean - bias_mm


class _Painted(NamedTuple):
    """Per point of the scan: is it the cable's, and where; NaN off the cable."""

    keep: np.ndarray
    deviation_mm: np.ndarray
    along_mm: np.ndarray
    angle_deg: np.ndarray


def _painted(fit: CableFit, rows: np.ndarray, n: int) -> _Painted:
    """Spread the fitted points' values over all rows of the scan."""

    def spread(values: np.ndarray) -> np.ndarray:
        out = np.full(n, np.nan)
        out[rows] = values
        return out

    keep = np.zeros(n, dtype=bool)
    keep[rows] = np.abs(fit.residual_mm) < KEEP_SIGMA * fit.noise_mm
    along = fit.place.s - fit.place.s[fit.weight > 0].min()
    angle = np.degrees(np.arctan2(fit.place.v, fit.place.u))
    return _Painted(keep, spread(fit.residual_mm), spread(along), spread(angle))


def measure_cable(
    cloud_or_xyz_mm: PointCloud | Num[np.ndarray, "n 3"],
    *,
    station: Int[np.ndarray, " n"] | None = None,
    on_cable: Bool[np.ndarray, " n"] | None = None,
    catalogue: Mapping[str, float] | None = None,
    settings: MeasureSettings | None = None,
) -> CableMeasurement:
    """Find the cable in a scan and measure it.

    Flat clutter is taken out, cylinders are sought by random samples, the best one is followed along its bends, and one
    radius with a smooth axis is fitted by robust least squares to the scan's own points, unfiltered: a filter would
    narrow the scatter and shift the surface. Noise widens a diameter by its square over the radius; that is taken off.

    Args:
        cloud_or_xyz_mm: The scan `[n, 3]` in millimetres, or a padded cloud. Rows with NaN are passed over. float64 is
            kept where it is given.
        station: Number of the scanner position of each point `[n]`, where the scan was put together from several: each
            position's shift is then fitted as well, and does not widen the diameter.
        on_cable: Which points may be the cable's `[n]`, where something has told, such as a network that labels parts
            (`cablejax.nets.label_parts`); the others are passed over. None lets all be looked at.
        catalogue: Overall diameter in mm of each nominal size by name, to tell the size from the diameter.
        settings: Thresholds and what is known of the scanner.

    Returns:
        The measurement; its arrays `keep` and `deviation_mm` have a row per row of the scan.

    Raises:
        MeasureError: If the scan does not hold a cable that can be measured, with the reason in words.
        ValueError: If the scan is not `[n, 3]`, or `on_cable` not one truth value a row.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> angle, along = rng.uniform(0, np.pi, 4000), rng.uniform(0, 200, 4000)
        >>> xyz = np.stack([along, 10 * np.cos(angle), 10 * np.sin(angle)], axis=1)
        >>> result = measure_cable(xyz + 0.05 * rng.normal(size=xyz.shape))
        >>> abs(result.diameter_mm - 20) < 0.02
        True
    """
    settings = settings if settings is not None else MeasureSettings()
    every, valid = _points(cloud_or_xyz_mm)
    if on_cable is not None:
        on_cable = np.asarray(on_cable)
        if on_cable.shape != valid.shape or on_cable.dtype != bool:
            raise ValueError(
                f"on_cable: expected {len(valid)} truth values, got {on_cable.dtype} {list(on_cable.shape)}"
            )
        check_labels(valid, on_cable)
        valid = valid & on_cable
    check_cloud(every[valid], len(every))
    shift = np.median(every[valid], axis=0)  # keeps the arithmetic near the origin
    xyz = every[valid] - shift
    find = find_cables(xyz, rng=np.random.default_rng(settings.seed))
    fitted, sections, arc = _best(xyz, None if station is None else np.asarray(station)[valid], find, settings)
    return _assembled(every, valid, shift, fitted, sections, arc, find, catalogue, settings)


def _assembled(
    every: Float[np.ndarray, "n 3"],
    valid: np.ndarray,
    shift: np.ndarray,
    fitted: _Fitted,
    sections: Sections,
    arc: float,
    find: Find,
    catalogue: Mapping[str, float] | None,
    settings: MeasureSettings,
) -> CableMeasurement:
    """The result from the fit: numbers, budget, nominal size and warnings."""
    fit, rows, sweep, *_ = fitted
    flat = too_flat(arc, fit.noise_mm, fit.radius_mm)
    if flat is not None:
        raise flat
    shape = oval(fit) if arc >= settings.oval_arc_deg else None
    profile, beam = None, _beams(fitted, settings)
    bias = beam.bias_mm
    if sweep is None:
        angle = np.arctan2(fit.place.v, fit.place.u)
        profile = shared_errors(angle, fit.residual_mm, fit.weight, given_std_mm=settings.registration_std_mm)
    diameter = _headline(fit, shape, profile, bias)
    lines = uncertainty_budget(
        fit,
        profile,
        bias=beam,
        higher_mm=_higher(fitted, beam, settings),
        scale_std=settings.scale_std,
        filter_std_mm=settings.filter_std_mm,
    )
    shared, open_mm = shared_mm(fit, sweep)
    if shared > ROUGHEST_SHARED * fit.radius_mm:
        raise not_one_surface(shared, fit.radius_mm)
    much = shared > SHARED_MOST * fit.noise_mm and open_mm > LEAST_OPEN * fit.radius_mm
    if arc < SHARED_ARC_DEG and much and settings.instrument is None:
        raise arc_too_small_for_errors(arc, SHARED_ARC_DEG, shared)
    lines.append(unseen_errors(shared, open_mm))
    std = combined(lines)
    if std > WORST_STD * diameter:
        raise unknown_diameter(diameter, std, arc)
    used = fit.weight > 0
    axis = trimmed(fit.axis, float(fit.place.s[used].min()), float(fit.place.s[used].max()))
    per_section = max(float(np.median(sections.points)), 1.0)
    center_std = fit.noise_mm * np.sqrt(360 / max(arc, 1.0) * 4 / per_section)
    bend = tightest_bend(axis, window_mm=8 * fit.radius_mm, center_std_mm=center_std)
    nominal_std = float(np.hypot(std, settings.maker_std_mm))
    nominal = {} if catalogue is None else nominal_probabilities(diameter, nominal_std, catalogue)
    painted = _painted(fit, np.flatnonzero(valid)[rows], len(every))
    result = CableMeasurement(
        diameter_mm=diameter,
        std_mm=std,
        interval_mm=(diameter - COVERAGE * std, diameter + COVERAGE * std),
        minimum_mm=None if shape is None else shape.minimum_mm - bias,
        maximum_mm=None if shape is None else shape.maximum_mm - bias,
        ovality=None if shape is None else (shape.maximum_mm - shape.minimum_mm) / shape.diameter_mm,
        ovality_std=None if shape is None else shape.amplitude_std_mm / shape.diameter_mm,
        length_mm=axis.length_mm,
        bend_radius_mm=None if bend is None else bend.radius_mm,
        bend_interval_mm=None if bend is None else bend.interval_mm,
        arc_deg=arc,
        noise_mm=fit.noise_mm,
        points=int(used.sum()),
        axis_mm=axis.xyz + shift,
        sections=sections._replace(s_mm=sections.s_mm - fit.place.s[used].min()),
        keep=painted.keep,
        deviation_mm=painted.deviation_mm,
        along_mm=painted.along_mm,
        angle_deg=painted.angle_deg,
        budget=lines,
        nominal=nominal,
        free_section=free_section(fit, bias),
        verdict=None if catalogue is None else verdict(nominal, diameter, nominal_std, catalogue),
    )
    result.warnings.extend(warnings_about(result, find, oval_arc_deg=settings.oval_arc_deg))
    result.warnings.extend(about_instrument(beam.excess, given=settings.instrument is not None))
    if shape is not None and sweep is not None and sweep.max() > 0:
        result.warnings.append(SHIFTED)
    return result
