"""How tightly an axis bends: the radius of the circle through stretches of it."""

from typing import NamedTuple

import numpy as np

from cablejax.geometry.robust import COVERAGE
from cablejax.measure.fit.axis import Axis

ALIKE = 2.0  # standard deviations below the largest curvature, within which those beside it count as the same bend
SHAPE = (
    0.006  # of the curvature: what stretches and splines make of bends that begin and end, as found on simulated ones
)


class Bend(NamedTuple):
    """The tightest bend: its radius in mm, where along the axis it is, and the 95 % interval of the radius."""

    radius_mm: float
    at_mm: float
    interval_mm: tuple[float, float]


def tightest_bend(axis: Axis, *, window_mm: float, center_std_mm: float) -> Bend | None:
    """The largest curvature over stretches of `window_mm`, or None where the axis is straight within its uncertainty.

    A parabola is fitted to each stretch in the frame of its middle. The axis is uncertain by `center_std_mm` per
    independent piece, taken as a quarter of the window. The largest of several curvatures that are alike is largest by
    chance: those beside it that do not differ by more than `ALIKE` standard deviations are averaged with it.

    Args:
        axis: The cable's axis.
        window_mm: Length of a stretch; shorter cables are looked at as a whole.
        center_std_mm: Standard deviation of the axis across its length.
    """
    window = min(window_mm, axis.length_mm)
    step = axis.s[1] - axis.s[0]
    half = max(2, int(window / 2 / step))
    rows = range(half, len(axis.s) - half, max(1, half // 4))
    curvature, where = [], []
    for row in rows:
        part = slice(row - half, row + half + 1)
        s = axis.s[part] - axis.s[row]
        offset = axis.xyz[part] - axis.xyz[row]
        bent = np.polynomial.polynomial.polyfit(s, offset, 2)[2]
        along = axis.tangent[row]
        parabola = 2 * float(np.linalg.norm(bent - (bent @ along) * along))
        curvature.append(
            parabola * (1 + (parabola * half * step) ** 2 / 14)
        )  # a circle's, from the parabola through it
        where.append(float(axis.s[row]))
    if not curvature:
        return None
    # A parabola through five independent centres over a window w: curvature std = 2 sqrt(180 / 5) std / w^2.
    std = 12.0 * center_std_mm / window**2
    best = int(np.argmax(curvature))
    alike = np.array(curvature) >= curvature[best] - ALIKE * std
    first = best - int(np.argmin(np.append(alike[best::-1], False))) + 1
    last = best + int(np.argmin(np.append(alike[best:], False)))
    k = float(np.mean(curvature[first:last]))
    if k < 3 * std:
        return None
    std = float(np.hypot(std, SHAPE * k))
    return Bend(1 / k, where[best], (1 / (k + COVERAGE * std), 1 / max(k - COVERAGE * std, 1e-12)))
