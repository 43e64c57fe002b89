"""What earns a fitted cylinder its place: what was sought, smooth, one surface, round, and enough of it seen."""

from typing import NamedTuple

import numpy as np

from cablejax.measure.errors import MeasureError
from cablejax.measure.find.cables import Find
from cablejax.measure.find.track import Track
from cablejax.measure.fit.axis import locate
from cablejax.measure.fit.full import Fitted, fit_track
from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.messages import (
    arc_too_small,
    made_of_smaller,
    no_surface,
    not_round,
    not_sought,
    nothing_found,
    strayed,
    too_rough,
)
from cablejax.measure.scan import Scan
from cablejax.measure.settings import MeasureSettings
from cablejax.measure.shape.faces import flat_faces
from cablejax.measure.shape.facing import faces_elsewhere
from cablejax.measure.shape.sections import Sections, arc_seen, cut
from cablejax.measure.shape.walls import Walls, filled, two_walls
from cablejax.measure.steps import step_across, too_coarse

ROUGHEST = 0.33  # scatter over the radius; points that fill a cylinder evenly scatter by .35 of their mean distance
PER_SECTION = 40  # points, on average, that a section must hold at least


class Strayed(MeasureError):
    """The fit has left what the search found: lesser finds of such a scan are no better."""


class Accepted(NamedTuple):
    """A fitted cylinder that has earned its place.

    Attributes:
        scan: The points that it was fitted to; of two surfaces about one axis those of one.
        fitted: The fit.
        sections: Its sections.
        arc_deg: Circumference seen.
        other_mm: Diameter of the other surface about the same axis; None where there is one alone.
        step_mm: Step of the coordinates across the axis; 0 where they have none.
    """

    scan: Scan
    fitted: Fitted
    sections: Sections
    arc_deg: float
    other_mm: float | None
    step_mm: float


def first_that_fits(scan: Scan, find: Find, settings: MeasureSettings) -> Accepted:
    """Fit the tracks in turn until one earns its place; the first one's failure if none does.

    Raises:
        MeasureError: That failure.
    """
    failure: MeasureError | None = None
    for track in find.tracks:
        try:
            return accepted(scan, track, find, settings)
        except Strayed as error:  # one of the lesser finds may fit something else very well
            raise failure or error from None
        except MeasureError as error:
            failure = failure or error
    raise failure or nothing_found(find)


def accepted(scan: Scan, track: Track, find: Find, settings: MeasureSettings) -> Accepted:
    """Fit one track, and refuse what is no cylinder.

    Raises:
        MeasureError: With the reason.
    """
    fitted, other = _fitted(scan, track, find, settings), None
    if (walls := two_walls(fitted.fit)) is not None:
        scan, other = _one_wall(scan, fitted.fit, walls, settings)
        fitted = _fitted(scan, track, find, settings)
    fit = fitted.fit
    if (error := strayed(track.radius_mm, fit.radius_mm)) is not None:
        raise Strayed(str(error))
    limits = settings.limits.diameter_mm
    if limits is not None and not limits[0] <= 2 * fit.radius_mm <= limits[1]:
        raise not_sought(2 * fit.radius_mm, limits)
    step = step_across(scan.xyz, fit.axis.tangent[len(fit.axis.tangent) // 2])
    if (error := too_coarse(step, 2 * fit.radius_mm)) is not None:
        raise error
    if fit.noise_mm > ROUGHEST * fit.radius_mm:
        raise too_rough(fit.noise_mm, fit.radius_mm)
    sections = sections_of(fit, settings)
    arc = arc_seen(fit, sections)
    if arc < settings.min_arc_deg:
        raise arc_too_small(arc, settings.min_arc_deg, find)
    if (faces := flat_faces(fit, arc)) is not None:
        raise not_round(faces, 2 * fit.radius_mm)
    if filled(scan.xyz, fit) is not None:
        raise no_surface(2 * fit.radius_mm)
    if faces_elsewhere(scan.xyz, fit) is not None:
        raise made_of_smaller(2 * fit.radius_mm)
    return Accepted(scan, fitted, sections, arc, other, step)


def _fitted(scan: Scan, track: Track, find: Find, settings: MeasureSettings) -> Fitted:
    try:
        return fit_track(scan, track, find.planes, settings)
    except MeasureError as error:
        # Nothing round there; where points stand in rows, or most is flat, that is the reason to give.
        coarse = too_coarse(step_across(scan.xyz, track.start.direction), 2 * track.radius_mm)
        raise coarse or (nothing_found(find) if find.flat_share > 0.5 else error) from None


def _one_wall(scan: Scan, fit: CableFit, walls: Walls, settings: MeasureSettings) -> tuple[Scan, float]:
    """The scan without the inner of two surfaces, or without the outer where the inner alone is sought; its diameter."""
    low, high = settings.limits.diameter_mm or (0.0, np.inf)
    inside = low <= walls.inner_mm <= high < walls.outer_mm
    place = locate(fit.axis, scan.xyz)
    within = np.hypot(place.u, place.v) < walls.between_mm
    return scan.subset(within == inside), walls.outer_mm if inside else walls.inner_mm


def sections_of(fit: CableFit, settings: MeasureSettings) -> Sections:
    """Circles along the length: a quarter of the diameter apart, or as asked, and further on a coarse grid."""
    used = fit.place.s[fit.weight > 0]
    length = float(np.ptp(used))
    step = settings.section_mm if settings.section_mm is not None else 0.5 * fit.radius_mm
    # On a coarse grid a short section holds two points, which show no arc.
    return cut(fit, step_mm=max(step, length / 200, length * PER_SECTION / len(used)))
