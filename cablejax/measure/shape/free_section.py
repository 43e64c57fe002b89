"""The section's own shape, common to the whole length: a closed curve of any smooth form, with its widths and perimeter."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.geometry.robust import robust_std
from cablejax.measure.fit.least_squares import CableFit, tukey
from cablejax.measure.shape.sections import arc_of

WAVES = 12  # highest harmonic of the radius over the angle: features of 30 degrees and wider
WHOLE_DEG = 345.0  # circumference that must be seen: the curve has no place to guess


class FreeSection(NamedTuple):
    """A closed curve about the axis, and its sizes after IEC 60811-203.

    Attributes:
        angle_deg: Directions `[180]`, degrees from the first vector of the axis frame.
        radius_mm: Distance of the curve from the axis in each `[180]`.
        std_mm: Its standard deviation from noise and number of points `[180]`.
        diameter_mm: Diameter of the circle of equal perimeter.
        diameter_std_mm: Its standard deviation.
        minimum_mm, maximum_mm: Least and greatest width between two parallel jaws.
        square_mm: Widths in the direction of the greatest and square to it.
    """

    angle_deg: Float[np.ndarray, " a"]
    radius_mm: Float[np.ndarray, " a"]
    std_mm: Float[np.ndarray, " a"]
    diameter_mm: float
    diameter_std_mm: float
    minimum_mm: float
    maximum_mm: float
    square_mm: tuple[float, float]


def _harmonics(angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n h"]:
    turns = np.arange(1, WAVES + 1) * angle[:, None]
    return np.concatenate([np.ones((len(angle), 1)), np.cos(turns), np.sin(turns)], axis=1)


def free_section(fit: CableFit, bias_mm: float) -> FreeSection | None:
    """Fit the radius as a Fourier series of the angle, by reweighted least squares over all points.

    Harmonics that do not stand out of their noise are shrunk (James and Stein 1961): c (1 - s^2 / c^2) where the pair's
    square c^2 exceeds its variance s^2, else zero, so that noise does not make a round section wavy.

    Args:
        fit: The fit of axis and radius.
        bias_mm: What noise along the beams has added to the diameter, by the scatter about a circle; taken off in the
            measure of the scatter about the shape.

    Returns:
        None where less than the whole circumference was seen.
    """
    angle = np.arctan2(fit.place.v, fit.place.u)
    if arc_of(angle[fit.weight > 0]) < WHOLE_DEG or len(angle) < 20 * (2 * WAVES + 1):
        return None
    columns, change = _harmonics(angle), np.zeros(2 * WAVES + 1)
    inverse, scale = np.eye(2 * WAVES + 1), fit.noise_mm
    for _ in range(4):  # the shape must not count as noise
        left = fit.residual_mm - columns @ change
        scale = max(robust_std(left), 1e-9)
        weight = tukey(left, scale)
        inverse = np.linalg.pinv(columns.T @ (weight[:, None] * columns))
        change = inverse @ (columns.T @ (weight * fit.residual_mm))
    variance = scale**2 * np.diag(inverse)
    cosine, sine = change[1 : WAVES + 1], change[WAVES + 1 :]
    noise, square = variance[1 : WAVES + 1] + variance[WAVES + 1 :], cosine**2 + sine**2
    keep = np.clip(1 - noise / np.maximum(square, 1e-300), 0.0, 1.0)
    change = np.concatenate([change[:1], keep * cosine, keep * sine])
    turn = np.radians(np.arange(180) * 2.0)
    around = _harmonics(turn)
    radius = fit.radius_mm + around @ change - 0.5 * bias_mm * (scale / fit.noise_mm) ** 2
    std = scale * np.sqrt(np.einsum("ah,hg,ag->a", around, inverse, around))
    return _sizes(turn, radius, std, 2 * float(np.sqrt(variance[0])))


def _sizes(turn: np.ndarray, radius: np.ndarray, std: np.ndarray, diameter_std: float) -> FreeSection:
    """Perimeter and widths of the curve: jaws touch its hull, so a width is the extent along a direction."""
    curve = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    chord = np.linalg.norm(np.roll(curve, -1, axis=0) - curve, axis=1)
    step = turn[1] - turn[0]
    perimeter = float(chord.sum()) * (step / 2) / np.sin(step / 2)  # chords of an arc fall short by this much
    jaws = np.stack([np.cos(turn[:90]), np.sin(turn[:90])], axis=1)
    width = np.ptp(curve @ jaws.T, axis=0)
    widest = int(np.argmax(width))
    square = (float(width[widest]), float(width[(widest + 45) % 90]))
    return FreeSection(
        angle_deg=np.degrees(turn),
        radius_mm=radius,
        std_mm=std,
        diameter_mm=perimeter / np.pi,
        diameter_std_mm=diameter_std,
        minimum_mm=float(width.min()),
        maximum_mm=float(width.max()),
        square_mm=square,
    )
