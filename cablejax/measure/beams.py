"""Noise along the beam: it moves a point around the circle as well as off it, and so moves the fitted radius.

A range error e on a beam that meets the surface at incidence i leaves e cos(i) off the surface and e sin(i) along it. A
point moved along the surface by t lies t^2 / 2R outside; and since the points thin out with cos(i), those that noise has
brought to a place come more from the denser side, and lie outside for that as well.
"""

import numpy as np
from jaxtyping import Float, Int

from cablejax.measure.fit import CableFit

BIN_DEG = 5.0
LARGEST = np.radians(72.0)  # incidence; beyond, points are left out or too few to matter
BEAM_DOUBT = 0.3  # of the correction: jitter across the beam adds less, and noise need not grow as assumed


def incidence(angle: Float[np.ndarray, " n"], sweep: Int[np.ndarray, " n"] | None) -> Float[np.ndarray, " n"] | None:
    """Signed angle in radians between each point's normal and the way to its scanner, around the axis `[n]`.

    Beams lie evenly across the view, so a sweep's points on a round surface thin out as the cosine of that angle: A cos +
    B sin is fitted to the numbers in bins of `BIN_DEG`, and points to the scanner. None where no direction stands out, or
    the sweeps are not known.
    """
    if sweep is None:
        return None
    count = int(360 / BIN_DEG)
    bins = np.minimum((np.degrees(angle) % 360 / BIN_DEG).astype(int), count - 1)
    middle = np.radians((np.arange(count) + 0.5) * BIN_DEG)
    columns = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    out = np.empty(len(angle))
    for name in range(int(sweep.max()) + 1):
        rows = sweep == name
        density = np.bincount(bins[rows], minlength=count).astype(float)
        within = (density > 0.3 * np.sort(density)[-4:].mean()) & (np.roll(density, 1) > 0) & (np.roll(density, -1) > 0)
        if within.sum() < 3:
            return None
        ahead, *_ = np.linalg.lstsq(columns[within], density[within], rcond=None)
        if np.hypot(*ahead) < 0.5 * density[within].mean():
            return None
        out[rows] = angle[rows] - np.arctan2(ahead[1], ahead[0])
    return np.arctan2(np.sin(out), np.cos(out))


def beam_bias_mm(fit: CableFit, sweep: Int[np.ndarray, " n"] | None) -> float:
    """How much noise along the beams has enlarged the fitted diameter.

    With residuals of variance s^2 the points found at an angle lie s^2 / R (1 + tan^2(i) / 2) outside on average; each
    counts by its weight in the radius. Where the directions of the beams are not known, s^2 / R is taken.
    """
    angle = np.arctan2(fit.place.v, fit.place.u)
    turned = incidence(angle, sweep)
    square = 0.0 if turned is None else np.tan(np.clip(turned, -LARGEST, LARGEST)) ** 2
    return float(2 * fit.noise_mm**2 / fit.radius_mm * np.sum(fit.lever * (1 + 0.5 * square)))
