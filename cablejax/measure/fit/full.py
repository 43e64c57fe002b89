"""One radius and a smooth axis fitted to the full cloud about a track, and what noise and beams have done to them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cablejax.measure.depth_image import undistorted
from cablejax.measure.errors import MeasureError, NoCableError
from cablejax.measure.find.planes import Plane
from cablejax.measure.find.track import Track
from cablejax.measure.fit.axis import Axis, Place, locate, point_at, sampled, trimmed
from cablejax.measure.fit.beam_noise import (
    RESCANNED,
    BeamBias,
    Instrument,
    beam_bias,
    clear_of_the_rim,
    known_beam_bias,
    rescanned,
)
from cablejax.measure.fit.least_squares import CableFit, fit_cable
from cablejax.measure.fit.start import MIN_ON_CABLE, Start, coarse_start, seen, tube
from cablejax.measure.fit.sweep_labels import at_the_edge, blocks, sweeps_of
from cablejax.measure.messages import not_found_again
from cablejax.measure.settings import MeasureSettings

KNOWN_STEEP = 30.0  # s^3 / R^2: what a known scanner's correction leaves open, as found on simulated scans


class Fitted(NamedTuple):
    """The fit, the rows that took part, the sweep of each if the sweeps are known, and where along the start they lay."""

    fit: CableFit
    rows: np.ndarray
    sweep: np.ndarray | None
    along: np.ndarray
    knots: float


def fit_track(
    xyz: np.ndarray, station: np.ndarray | None, track: Track, planes: list[Plane], settings: MeasureSettings
) -> Fitted:
    """Fit axis and radius to the full cloud about a track, with a shift for every sweep that is known."""
    start = coarse_start(xyz, track, planes)
    rows, along = tube(start.axis, start.radius, xyz, planes, start.width, beyond=start.radius)
    fit, sweep = _with_sweeps(xyz, station, rows, along, start, settings)
    low, high = seen(fit)
    inside = (fit.place.s >= low) & (fit.place.s <= high)
    if not inside[fit.weight > 0].all():  # the coarse fit's ends are those of its few points
        if inside.sum() < MIN_ON_CABLE:
            raise NoCableError(f"Too few points on the cable: {inside.sum()} where at least {MIN_ON_CABLE} are needed.")
        rows, along = rows[inside], along[inside]
        start = start._replace(axis=trimmed(fit.axis, low, high), radius=fit.radius_mm)
        fit, sweep = _with_sweeps(xyz, station, rows, along, start, settings)
    return Fitted(fit, rows, sweep, along, start.knots)


def _with_sweeps(
    xyz: np.ndarray,
    station: np.ndarray | None,
    rows: np.ndarray,
    along: np.ndarray,
    start: Start,
    settings: MeasureSettings,
) -> tuple[CableFit, np.ndarray | None]:
    """The fit to some rows, and the sweep of each if the sweeps are known; a single view has none."""
    sweep = None if settings.stations == 1 else sweeps_of(along)
    if station is not None:
        named = np.unique(station[rows], return_inverse=True)[1].reshape(-1)
        both = named if sweep is None else named * (sweep.max() + 1) + sweep
        sweep = np.unique(both, return_inverse=True)[1].reshape(-1)
    fit = _about(xyz[rows], start.axis, start.radius, start.noise, sweep, along, settings.instrument, start.knots)
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
    inlier = ~at_the_edge(place, sweep, noise_mm=noise, radius_mm=radius)
    if instrument is not None:
        inlier &= clear_of_the_rim(place, sweep, radius_mm=radius, instrument=instrument)
    if sweep is None or sweep.max() == 0:
        return fit_cable(xyz, axis, radius, inlier=inlier, knot_diameters=knots)
    pieces = max(1, min(8, len(xyz) // (500 * int(sweep.max() + 1))))
    block = blocks(sweep, along, pieces=pieces)
    return fit_cable(xyz, axis, radius, block=block, inlier=inlier, knot_diameters=knots)


def beams(fitted: Fitted, settings: MeasureSettings) -> BeamBias:
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


def _refit(fitted: Fitted, settings: MeasureSettings) -> Callable[[np.ndarray, np.ndarray], CableFit]:
    """What fits points that stand for some rows of those that were fitted, in the same way."""
    fit, sweep = fitted.fit, fitted.sweep

    def refit(xyz: np.ndarray, rows: np.ndarray) -> CableFit:
        named = None if sweep is None else np.unique(sweep[rows], return_inverse=True)[1].reshape(-1)
        start = (fit.axis, fit.radius_mm, fit.noise_mm)
        return _about(xyz, *start, named, fitted.along[rows], settings.instrument, fitted.knots)

    return refit


def higher_order(fitted: Fitted, beam: BeamBias, settings: MeasureSettings) -> float:
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


def lens_effect(fitted: Fitted, origin: np.ndarray, settings: MeasureSettings) -> float:
    """By how much the diameter would change if the lens of a depth image had the distortion of `settings.lens_std`.

    The fitted cable without noise, seen through such a lens, is fitted again. Its axis is moved along, so that what counts is
    how a section is drawn out, and not how all of it is displaced.

    Raises:
        MeasureError: If what the lens makes of the cable cannot be fitted.
    """
    if settings.lens_std == 0:
        return 0.0
    fit = fitted.fit
    rows = np.flatnonzero(fit.weight > 0)
    rows = rows[:: max(1, len(rows) // RESCANNED)]
    angle = np.arctan2(fit.place.v, fit.place.u)[rows]
    on = Place(fit.place.s[rows], fit.radius_mm * np.cos(angle), fit.radius_mm * np.sin(angle))
    xyz = undistorted(point_at(fit.axis, on) + origin, settings.lens_std) - origin
    axis = undistorted(fit.axis.xyz + origin, settings.lens_std) - origin
    axis = sampled(axis, step=float(fit.axis.s[1] - fit.axis.s[0]))
    sweep = None if fitted.sweep is None else np.unique(fitted.sweep[rows], return_inverse=True)[1].reshape(-1)
    again = _about(xyz, axis, fit.radius_mm, fit.noise_mm, sweep, fitted.along[rows], settings.instrument, fitted.knots)
    return 2 * abs(again.radius_mm - fit.radius_mm)
