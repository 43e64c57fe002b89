"""What the camera of a depth image may have done to a diameter: the fitted cable is seen through it, and fitted again."""

import numpy as np

from cablejax.measure.depth_image import WINDOW_PX, DepthImage, blurred, undistorted
from cablejax.measure.errors import MeasureError
from cablejax.measure.fit.axis import Place, bearing, point_at, sampled
from cablejax.measure.fit.beam_noise import RESCANNED, placed
from cablejax.measure.fit.full import Fitted, fit_about, refit_of
from cablejax.measure.messages import too_few_pixels


def lens_effect(fitted: Fitted, origin: np.ndarray, coefficient: float) -> float:
    """By how much the diameter would change in mm if the lens had a radial distortion, none of which was taken out.

    The axis is moved along with its points, so that what counts is how a section is drawn out, and not how all of it is
    displaced.

    Args:
        fitted: The fit, whose points carry no noise here.
        origin: What was taken off the camera's coordinates `[3]`.
        coefficient: The first of Brown's model.

    Raises:
        MeasureError: If what the lens makes of the cable cannot be fitted.
    """
    if coefficient == 0:
        return 0.0
    fit = fitted.fit
    rows = _some(fitted)
    angle = np.arctan2(fit.place.v, fit.place.u)[rows]
    on = Place(fit.place.s[rows], fit.radius_mm * np.cos(angle), fit.radius_mm * np.sin(angle))
    xyz = undistorted(point_at(fit.axis, on) + origin, coefficient) - origin
    axis = undistorted(fit.axis.xyz + origin, coefficient) - origin
    axis = sampled(axis, step=float(fit.axis.s[1] - fit.axis.s[0]))
    sweep = None if fitted.sweep is None else np.unique(fitted.sweep[rows], return_inverse=True)[1].reshape(-1)
    start = (axis, fit.radius_mm, fit.noise_mm)
    again = fit_about(xyz, *start, sweep, fitted.along[rows], fitted.view, fitted.knots)
    return 2 * abs(again.radius_mm - fit.radius_mm)


def blur_effect(fitted: Fitted, camera: DepthImage) -> float:
    """By how much the diameter would change in mm if depths were blurred over `WINDOW_PX` pixels.

    Raises:
        MeasureError: If so few pixels see the cable that nothing round is left of it.
    """
    fit, eye = fitted.fit, fitted.view.eye
    assert eye is not None
    rows = _some(fitted)
    turned = (np.arctan2(fit.place.v, fit.place.u) - bearing(fit.axis, fit.place.s, eye))[rows]
    seen = np.cos(turned) > 0
    rows, turned = rows[seen], turned[seen]
    aside = fit.radius_mm * np.sin(turned)
    pitch = camera.pitch_mm(float(np.median(np.linalg.norm(fit.axis.xyz - eye, axis=1))))
    depth = blurred(aside, fit.radius_mm, WINDOW_PX * pitch)
    try:
        again = refit_of(fitted)(placed(fit, rows, turned, aside, depth), rows)
    except MeasureError:
        raise too_few_pixels(2 * fit.radius_mm, pitch) from None
    return 2 * abs(again.radius_mm - fit.radius_mm)


def _some(fitted: Fitted) -> np.ndarray:
    """Rows of the points that the diameter rests on, some thousands at most."""
    rows = np.flatnonzero(fitted.fit.weight > 0)
    return rows[:: max(1, len(rows) // RESCANNED)]
