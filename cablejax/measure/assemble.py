"""The result from an accepted fit: diameter, budget, shape, nominal size and warnings, or why there is no diameter."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cablejax.geometry.robust import COVERAGE, robust_std
from cablejax.measure.accept import PER_SECTION, Accepted
from cablejax.measure.find.cables import Find
from cablejax.measure.fit.axis import Axis, trimmed
from cablejax.measure.fit.beam_noise import BeamBias
from cablejax.measure.fit.depth_camera import blur_effect, lens_effect
from cablejax.measure.fit.full import Fitted, beams, higher_order
from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.messages import (
    about_form,
    about_instrument,
    about_shifts,
    about_walls,
    arc_too_small_for_errors,
    not_one_surface,
    too_flat,
    unknown_diameter,
    warnings_about,
)
from cablejax.measure.nominal import nominal_probabilities, verdict
from cablejax.measure.result import BudgetLine, CableMeasurement
from cablejax.measure.scan import Scan
from cablejax.measure.settings import MeasureSettings
from cablejax.measure.shape.bend import Bend, tightest_bend
from cablejax.measure.shape.free_section import free_section
from cablejax.measure.shape.profile import Profile, profile_along
from cablejax.measure.shape.sections import Oval, Sections, between, oval
from cablejax.measure.shape.stretches import ONE, Stretch, diameter_at, form_of, mean_of, stretches_of, within
from cablejax.measure.steps import about_steps
from cablejax.measure.uncertainty import alignment
from cablejax.measure.uncertainty.budget import CORRELATED, FORM, NOISE, combined, uncertainty_budget
from cablejax.measure.uncertainty.shared_errors import shared_mm

WORST_STD = 0.25  # of the diameter: beyond, the interval reaches from less than half of it to more than one and a half
SHARED_ARC_DEG = 65.0  # with errors that neighbours share, an arc below tells nothing unless the scanner is known
LEAST_OPEN = 0.02  # of the radius, that they must leave open to matter: scans without noise share micrometres
SHARED_MOST = 0.5  # of the scatter: shared errors above are the scanner's own, and not its noise
ROUGHEST_SHARED = 0.1  # of the radius: neighbouring points that leave the circle together by more lie on something else
COVERED, LONG, STEADY = (
    0.5,
    4.0,
    0.2,
)  # of the length with sections, diameters long, and of the diameter that sections differ
SMOOTH = 0.05  # scatter over the radius, above which circles of single sections are off by the noise itself
SECTION = 0.25  # radii between the circles that tell the form
BETTER = 0.8  # of the scatter about one diameter: several must leave less, or their circles are made of noise
KEEP_SIGMA = 3.5  # standard deviations from the surface within which a point counts as the cable's


class _Form(NamedTuple):
    """The thing along its length.

    Attributes:
        stretches: Of constant or tapering diameter.
        residual_mm: The points' distances from a surface of these diameters `[n]`.
        mean_mm: Mean diameter over the length; None where it is one.
        spread_mm: Standard deviation of the diameter along the length, 0 where it is one.
        against_mm: Excess of the sections' mean diameter over the fitted one.
        words: See `CableMeasurement.form`.
        uneven: What to say and the spread of the diameter where neighbouring points leave the surface together; None where
            the sections are too few or too different for one thing.
    """

    stretches: tuple[Stretch, ...]
    residual_mm: np.ndarray
    mean_mm: float | None
    spread_mm: float
    against_mm: float
    words: str
    uneven: tuple[str, float] | None


class _Diameter(NamedTuple):
    """The diameter, what the beams have done to it and was taken off, its uncertainty by source, the section's oval, and the
    form along the length in words."""

    value_mm: float
    beam: BeamBias
    budget: tuple[BudgetLine, ...]
    std_mm: float
    shape: Oval | None
    form: str


def assembled(
    one: Accepted,
    find: Find,
    catalogue: Mapping[str, float] | None,
    settings: MeasureSettings,
) -> CableMeasurement:
    """The result from the fit: numbers, budget, nominal size and warnings.

    Raises:
        MeasureError: If the diameter cannot be told.
    """
    scan, fitted, sections, arc, other, step = one
    fit = fitted.fit
    form = _form(scan, fitted, find)
    diameter = _diameter(scan, fitted, form, arc, settings)
    value, std, shape, bias = diameter.value_mm, diameter.std_mm, diameter.shape, diameter.beam.bias_mm
    used = fit.weight > 0
    low, high = float(fit.place.s[used].min()), float(fit.place.s[used].max())
    axis = trimmed(fit.axis, low, high)
    bend = _bend(fit, axis, sections, arc)
    nominal_std = float(np.hypot(std, settings.maker_std_mm))
    nominal = {} if catalogue is None else nominal_probabilities(value, nominal_std, catalogue)
    painted = _painted(fit, scan.rows[fitted.rows], scan.count)
    return CableMeasurement(
        diameter_mm=value,
        std_mm=std,
        interval_mm=(value - COVERAGE * std, value + COVERAGE * std),
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
        axis_mm=axis.xyz + scan.origin,
        sections=between(sections, low, high),
        form=diameter.form,
        stretches=_with_common(form.stretches, diameter, low),
        keep=painted.keep,
        deviation_mm=painted.deviation_mm,
        along_mm=painted.along_mm,
        angle_deg=painted.angle_deg,
        budget=diameter.budget,
        nominal=nominal,
        free_section=free_section(fit, bias),
        verdict=None if catalogue is None else verdict(nominal, value, nominal_std, catalogue),
        warnings=(
            *warnings_about(value, axis.length_mm, arc, find, oval_arc_deg=settings.oval_arc_deg),
            *about_instrument(diameter.beam.excess, given=settings.instrument is not None),
            *about_walls(value, other),
            *about_steps(step, value),
            *about_form(diameter.form),
            *about_shifts(fitted.sweep, oval_known=shape is not None),
        ),
    )


def _one_diameter(fit: CableFit) -> _Form:
    """The common fit alone, where no stretch is known."""
    return _Form(
        stretches=(),
        residual_mm=fit.residual_mm,
        mean_mm=None,
        spread_mm=0.0,
        against_mm=0.0,
        words=ONE,
        uneven=None,
    )


def _form(scan: Scan, fitted: Fitted, find: Find) -> _Form:
    """What circles of any size along the axis say about the thing's form."""
    fit = fitted.fit
    off_planes = ~np.any(
        [np.zeros(len(scan.xyz), dtype=bool), *(plane.holds(scan.xyz) for plane in find.planes)], axis=0
    )
    length = fit.axis.length_mm
    step = max(SECTION * fit.radius_mm, length / 200, length * PER_SECTION / max(int((fit.weight > 0).sum()), 1))
    profile = profile_along(
        scan.xyz[off_planes], fit.axis, radius_mm=fit.radius_mm, noise_mm=fit.noise_mm, step_mm=step
    )
    correlation = max(fit.clustered_mm / max(fit.random_mm, 1e-12), 1.0)
    stretches = stretches_of(profile, common_std_mm=0.0, correlation=correlation)
    inside = within(stretches, 0.0, length)
    if not inside:
        return _one_diameter(fit)
    used = fit.weight > 0
    residual = profile.distance(fit.place) - 0.5 * diameter_at(inside, fit.place.s)
    if form_of(inside) != ONE and robust_std(residual[used]) > BETTER * robust_std(fit.residual_mm[used]):
        profile = profile.subset((profile.s_mm >= 0) & (profile.s_mm <= length))
        stretches = inside = stretches_of(profile, common_std_mm=0.0, correlation=correlation, most=1)
    if not inside:
        return _one_diameter(fit)
    mean, spread = mean_of(inside)
    one = form_of(inside) == ONE
    own = max(part.std_mm for part in inside)
    apart = (mean - 2 * fit.radius_mm) ** 2 - own**2 - (2 * fit.clustered_mm) ** 2
    smooth = fit.noise_mm < SMOOTH * fit.radius_mm
    return _Form(
        stretches=stretches,
        residual_mm=fit.residual_mm if one else residual,
        mean_mm=None if one else mean,
        spread_mm=spread,
        against_mm=float(np.sqrt(max(apart, 0.0))) if one and smooth and _steady(profile, length) else 0.0,
        words=form_of(stretches),
        uneven=_uneven(profile, length),
    )


def _uneven(profile: Profile, length: float) -> tuple[str, float] | None:
    """The sections of a thing that is long and everywhere about as wide, though its surface is not that of a cylinder."""
    d = profile.diameter_mm
    if length < LONG * np.median(d) or not _steady(profile, length):
        return None
    low, high = np.quantile(d, [0.1, 0.9])
    return f"not one diameter: sections of {low:.4g} to {high:.4g} mm", robust_std(d - np.median(d))


def _steady(profile: Profile, length: float) -> bool:
    """Whether circles were found along most of the axis and are about as wide: else they are of other things, or of noise."""
    d = profile.diameter_mm
    covered = len(d) * profile.step_mm >= COVERED * length
    return bool(covered and robust_std(d - np.median(d)) <= STEADY * np.median(d))


def _with_common(stretches: tuple[Stretch, ...], diameter: _Diameter, low: float) -> tuple[Stretch, ...]:
    """Stretches with the uncertainty that all diameters of the scan share, in proportion to them, counted from the thing's
    beginning; what the beams have added is taken off."""
    own = (NOISE, CORRELATED, FORM)
    common = combined([line for line in diameter.budget if line.source not in own])
    return tuple(
        one._replace(
            from_mm=one.from_mm - low,
            to_mm=one.to_mm - low,
            first_mm=one.first_mm - diameter.beam.bias_mm,
            last_mm=one.last_mm - diameter.beam.bias_mm,
            std_mm=float(np.hypot(one.std_mm, common * 0.5 * (one.first_mm + one.last_mm) / diameter.value_mm)),
        )
        for one in stretches
    )


def _diameter(scan: Scan, fitted: Fitted, form: _Form, arc: float, settings: MeasureSettings) -> _Diameter:
    """Diameter and uncertainty.

    Raises:
        MeasureError: If the uncertainty is too large, or the errors that neighbours share do not allow to give one.
    """
    fit, sweep = fitted.fit, fitted.sweep
    if (flat := too_flat(arc, fit.noise_mm, fit.radius_mm)) is not None:
        raise flat
    shape = oval(fit) if arc >= settings.oval_arc_deg else None
    profile, beam = None, beams(fitted, settings)
    if sweep is None and settings.stations != 1:
        angle = np.arctan2(fit.place.v, fit.place.u)
        profile = alignment.shared_errors(angle, fit.residual_mm, fit.weight, given_std_mm=settings.registration_std_mm)
    value = _headline(fit, shape, profile, beam.bias_mm) if form.mean_mm is None else form.mean_mm - beam.bias_mm
    shared, open_mm = shared_mm(fit, sweep, residual_mm=form.residual_mm)
    if shared > ROUGHEST_SHARED * fit.radius_mm:
        if form.uneven is None:
            raise not_one_surface(shared, fit.radius_mm)
        words, spread = form.uneven
        form = form._replace(words=words, spread_mm=max(spread, form.spread_mm))
    much = shared > SHARED_MOST * fit.noise_mm and open_mm > LEAST_OPEN * fit.radius_mm
    if arc < SHARED_ARC_DEG and much and settings.instrument is None:
        raise arc_too_small_for_errors(arc, SHARED_ARC_DEG, shared)
    budget = uncertainty_budget(
        fit,
        profile,
        bias=beam,
        higher_mm=higher_order(fitted, beam, settings),
        shared_mm=shared,
        unseen_mm=open_mm,
        form=form.words,
        form_mm=form.spread_mm,
        against_mm=form.against_mm if sweep is None else 0.0,  # sections still hold the sweeps' shifts
        scale_std=settings.scale_std,
        filter_std_mm=settings.filter_std_mm,
        lens_mm=0.0 if scan.camera is None else lens_effect(fitted, scan.origin, settings.lens_std),
        blur_mm=0.0 if scan.camera is None else blur_effect(fitted, scan.camera),
        one_view=settings.stations == 1,
    )
    std = combined(budget)
    # A thing of several diameters has no narrow interval for one, and is known all the same.
    if np.sqrt(std**2 - form.spread_mm**2) > WORST_STD * value:
        raise unknown_diameter(value, std, arc)
    return _Diameter(value_mm=value, beam=beam, budget=budget, std_mm=std, shape=shape, form=form.words)


def _headline(fit: CableFit, shape: Oval | None, profile: alignment.Profile | None, bias_mm: float) -> float:
    """The diameter reported: of the circle, or of an oval much larger than the errors that directions share.

    What the beams have done to it is taken off, and from a circle what the directions' errors have most likely done to it.
    """
    shared, change = (0.0, 0.0) if profile is None else (profile.shared_mm, profile.change_mm)
    unsure = 0.0 if shape is None else max(shape.amplitude_std_mm, 4 * shared)
    certain = shape is not None and shape.maximum_mm - shape.minimum_mm > 4 * unsure
    mean = shape.diameter_mm if shape is not None and certain else 2 * (fit.radius_mm + change)
    return mean - bias_mm


def _bend(fit: CableFit, axis: Axis, sections: Sections, arc: float) -> Bend | None:
    """The tightest bend. The axis is uncertain by the noise over the points of a section, and more where residuals hang
    together: in the ratio of the radius's two standard deviations."""
    per_section = max(float(np.median(sections.points)), 1.0)
    together = max(fit.clustered_mm / max(fit.random_mm, 1e-12), 1.0)
    center_std = fit.noise_mm * np.sqrt(360 / max(arc, 1.0) * 4 / per_section) * together
    return tightest_bend(axis, window_mm=8 * fit.radius_mm, center_std_mm=center_std)


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

    used = fit.place.s[fit.weight > 0]
    along = fit.place.s - used.min()
    keep = np.zeros(n, dtype=bool)  # what lies on the surface beyond the ends is something else
    keep[rows] = (np.abs(fit.residual_mm) < KEEP_SIGMA * fit.noise_mm) & (along >= 0) & (along <= np.ptp(used))
    angle = np.degrees(np.arctan2(fit.place.v, fit.place.u))
    return _Painted(keep, spread(fit.residual_mm), spread(along), spread(angle))
