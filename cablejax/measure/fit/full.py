"""One radius and a smooth axis fitted to the full cloud about a track, and what noise and beams have done to them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cablejax.measure.errors import MeasureError, NoCableError
from cablejax.measure.find.planes import Plane
from cablejax.measure.find.track import Track
from cablejax.measure.fit.axis import Axis, bearing, locate, trimmed
from cablejax.measure.fit.beam_noise import (
    BeamBias,
    Instrument,
    beam_bias,
    clear_of_the_rim,
    known_beam_bias,
    rescanned,
)
from cablejax.measure.fit.least_squares import CableFit, fit_cable
from cablejax.measure.fit.start import MIN_ON_CABLE, Start, coarse_start, seen, tube
from cablejax.measure.fit.sweep_labels import GRAZING, at_the_edge, blocks, sweeps_of
from cablejax.measure.messages import not_found_again
from cablejax.measure.scan import Scan
from cablejax.measure.settings import MeasureSettings

KNOWN_STEEP = 30.0  # s^3 / R^2: what a known scanner's correction leaves open, as found on simulated scans


class View(NamedTuple):
    """What is known of how the points were seen: the scanner, and the place of a depth image's camera `[3]`."""

    instrument: Instrument | None
    eye: np.ndarray | None


class Fitted(NamedTuple):
    """The fit, the rows that took part, the sweep of each if the sweeps are known, where along the start they lay, the
    diameters between knots, and how they were seen."""

    fit: CableFit
    rows: np.ndarray
    sweep: np.ndarray | None
    along: np.ndarray
    knots: float
    view: View


def fit_track(scan: Scan, track: Track, planes: list[Plane], settings: MeasureSettings) -> Fitted:
    """Fit axis and radius to the full cloud about a track, with a shift for every sweep that is known."""
    xyz, station = scan.xyz, scan.station
    view = View(settings.instrument, None if scan.camera is None else -scan.origin)
    start = coarse_start(xyz, track, planes)
    rows, along = tube(start.axis, start.radius, xyz, planes, start.width, beyond=start.radius)
    fit, sweep = _with_sweeps(xyz, station, rows, along, start, settings, view)
    low, high = seen(fit)
    inside = (fit.place.s >= low) & (fit.place.s <= high)
    if not inside[fit.weight > 0].all():  # the coarse fit's ends are those of its few points
        if inside.sum() < MIN_ON_CABLE:
            raise NoCableError(f"Too few points on the cable: {inside.sum()} where at least {MIN_ON_CABLE} are needed.")
        rows, along = rows[inside], along[inside]
        start = start._replace(axis=trimmed(fit.axis, low, high), radius=fit.radius_mm)
        fit, sweep = _with_sweeps(xyz, station, rows, along, start, settings, view)
    return Fitted(fit, rows, sweep, along, start.knots, view)


def _with_sweeps(
    xyz: np.ndarray,
    station: np.ndarray | None,
    rows: np.ndarray,
    along: np.ndarray,
    start: Start,
    settings: MeasureSettings,
    view: View,
) -> tuple[CableFit, np.ndarray | None]:
    """The fit to some rows, and the sweep of each if the sweeps are known; a single view has none."""
    sweep = None if settings.stations == 1 else sweeps_of(along)
    if station is not None:
        named = np.unique(station[rows], return_inverse=True)[1].reshape(-1)
        both = named if sweep is None else named * (sweep.max() + 1) + sweep
        sweep = np.unique(both, return_inverse=True)[1].reshape(-1)
    fit = fit_about(xyz[rows], start.axis, start.radius, start.noise, sweep, along, view, start.knots)
    return fit, sweep


def fit_about(
    xyz: np.ndarray,
    axis: Axis,
    radius: float,
    noise: float,
    sweep: np.ndarray | None,
    along: np.ndarray,
    view: View,
    knots: float,
) -> CableFit:
    """The fit about a start, with a shift for every sweep that is known and without the edges of what it saw.

    Where the camera is known, what it sees at a grazing angle or not at all is left out as well.
    """
    place = locate(axis, xyz)
    inlier = ~at_the_edge(place, sweep, noise_mm=noise, radius_mm=radius)
    if view.instrument is not None:
        inlier &= clear_of_the_rim(place, sweep, radius_mm=radius, instrument=view.instrument)
    if view.eye is not None:
        inlier &= np.cos(np.arctan2(place.v, place.u) - bearing(axis, place.s, view.eye)) > GRAZING
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
            known = known_beam_bias(fitted.fit, fitted.sweep, settings.instrument, refit_of(fitted), rng)
        except MeasureError as error:
            raise not_found_again(str(error), known=True) from None
    return beam_bias(fitted.fit, fitted.sweep) if known is None else known


def refit_of(fitted: Fitted) -> Callable[[np.ndarray, np.ndarray], CableFit]:
    """What fits points that stand for some rows of those that were fitted, in the same way."""
    fit, sweep = fitted.fit, fitted.sweep

    def refit(xyz: np.ndarray, rows: np.ndarray) -> CableFit:
        named = None if sweep is None else np.unique(sweep[rows], return_inverse=True)[1].reshape(-1)
        start = (fit.axis, fit.radius_mm, fit.noise_mm)
        return fit_about(xyz, *start, named, fitted.along[rows], fitted.view, fitted.knots)

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
        return abs(rescanned(fitted.fit, fitted.sweep, refit_of(fitted), rng) - beam.bias_mm)
    except MeasureError as error:
        raise not_found_again(str(error), known=False) from None
