"""Cross-sections along a cable: a circle in each slab, and the oval common to all."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from cablejax.geometry.robust import robust_std
from cablejax.measure.fit.least_squares import CableFit, tukey

BIN_DEG = 5.0
OVAL_DEG = 175.0
MIN_POINTS = 12


class Sections(NamedTuple):
    """Circles fitted to slabs, each with its own centre and radius.

    Attributes:
        s_mm: Middle of each slab along the axis `[m]`.
        diameter_mm: Diameter of each circle `[m]`; NaN where the slab holds too few points or too small an arc.
        std_mm: Its standard deviation from noise, arc and number of points `[m]`.
        arc_deg: Circumference seen in each slab `[m]`, degrees, in steps of `BIN_DEG`.
        points: Points with weight in each slab `[m]`.
        minimum_mm, maximum_mm: Least and greatest diameter of each slab `[m]`, of a circle with one oval harmonic; NaN
            where the slab shows less than `OVAL_DEG`.
        oval_std_mm: Standard deviation of the difference between them `[m]`.
    """

    s_mm: Float[np.ndarray, " m"]
    diameter_mm: Float[np.ndarray, " m"]
    std_mm: Float[np.ndarray, " m"]
    arc_deg: Float[np.ndarray, " m"]
    points: Float[np.ndarray, " m"]
    minimum_mm: Float[np.ndarray, " m"]
    maximum_mm: Float[np.ndarray, " m"]
    oval_std_mm: Float[np.ndarray, " m"]


class Oval(NamedTuple):
    """The section common to the whole length, as a circle with one oval harmonic about the fitted axis.

    Attributes:
        diameter_mm: Mean diameter; to second order in the ovality that of a circle with the same perimeter.
        std_mm: Its standard deviation.
        minimum_mm, maximum_mm: Least and greatest diameter, which are square to each other.
        amplitude_std_mm: Standard deviation of the difference between them.
        direction_deg: Where the greatest diameter points, degrees from the first vector of the axis frame.
    """

    diameter_mm: float
    std_mm: float
    minimum_mm: float
    maximum_mm: float
    amplitude_std_mm: float
    direction_deg: float


def _angles(fit: CableFit) -> np.ndarray:
    return np.arctan2(fit.place.v, fit.place.u)


def bins_of(angle: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The bin around the circumference of angles in radians; one a hair below zero is rounded up to a whole turn."""
    return np.floor(np.degrees(angle) % 360 / BIN_DEG).astype(int) % int(360 / BIN_DEG)


def arc_of(angle: Float[np.ndarray, " n"], *, share: float = 0.02) -> float:
    """Degrees of circumference that hold points, in bins of `BIN_DEG` with more than a share of what the fullest eight hold."""
    counts = np.bincount(bins_of(angle), minlength=int(360 / BIN_DEG))
    return float((counts > share * np.sort(counts)[-8:].mean()).sum() * BIN_DEG)


def arc_seen(fit: CableFit, sections: Sections) -> float:
    """Degrees of circumference that the scan shows: in the middle one of its sections, and over the whole length.

    A section of few points leaves gaps, a whole cable seen from different sides along its length shows more than any section
    does, and stray points show in single sections everywhere: the lesser of the two counts.
    """
    held = sections.points >= 0.2 * np.median(sections.points)
    whole = arc_of(_angles(fit)[fit.weight > 0], share=0.1)
    return min(float(np.median(sections.arc_deg[held])), whole)


def cut(fit: CableFit, *, step_mm: float) -> Sections:
    """Fit a circle, centre free, in slabs `step_mm` long, and an oval where enough is seen: a linear step from the common fit.

    A slab's centre lies within the noise of the axis, so the step is exact to the square of that over the radius.
    """
    s, angle = fit.place.s, _angles(fit)
    count = max(1, int(np.ceil((s.max() - s.min() + 1e-9) / step_mm)))
    width = (s.max() - s.min() + 1e-9) / count
    slab = np.minimum(((s - s.min()) / width).astype(int), count - 1)
    weight = tukey(fit.residual_mm, fit.noise_mm)
    used = weight > 0
    points = np.bincount(slab[used], minlength=count).astype(float)
    covered = np.zeros((count, int(360 / BIN_DEG)), dtype=bool)
    covered[slab[used], bins_of(angle[used])] = True
    arc = covered.sum(axis=1) * BIN_DEG
    circle = [np.ones_like(angle), np.cos(angle), np.sin(angle)]
    change, covariance = _slabs(fit, slab, count, np.stack(circle), weight, points >= MIN_POINTS)
    both = np.stack([*circle, np.cos(2 * angle), np.sin(2 * angle)])
    shaped, doubt = _slabs(fit, slab, count, both, weight, (points >= 2 * MIN_POINTS) & (arc >= OVAL_DEG))
    # Noise makes an amplitude out of nothing: its expected square is taken off.
    noise = doubt[:, 3, 3] + doubt[:, 4, 4]
    amplitude = np.sqrt(np.maximum(shaped[:, 3] ** 2 + shaped[:, 4] ** 2 - noise, 0.0))
    mean = 2 * (fit.radius_mm + shaped[:, 0])
    return Sections(
        s_mm=s.min() + (np.arange(count) + 0.5) * width,
        diameter_mm=2 * (fit.radius_mm + change[:, 0]),
        std_mm=2 * np.sqrt(covariance[:, 0, 0]),
        arc_deg=arc,
        points=points,
        minimum_mm=mean - 2 * amplitude,
        maximum_mm=mean + 2 * amplitude,
        oval_std_mm=4 * np.sqrt(np.maximum(doubt[:, 3, 3], doubt[:, 4, 4])),
    )


def between(sections: Sections, low_mm: float, high_mm: float) -> Sections:
    """The sections of a stretch, counted from its beginning: slabs beyond the ends hold what lies about them."""
    inside = (sections.s_mm >= low_mm) & (sections.s_mm <= high_mm)
    kept = Sections(*(values[inside] for values in sections))
    return kept._replace(s_mm=kept.s_mm - low_mm)


def _slabs(
    fit: CableFit, slab: np.ndarray, count: int, columns: np.ndarray, weight: np.ndarray, wanted: np.ndarray
) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "m c c"]]:
    """Least squares of the residuals on `columns` `[c, n]` in each slab, and the covariance; NaN where it cannot be told."""
    c = len(columns)
    normal, right = np.empty((count, c, c)), np.empty((count, c))
    for i in range(c):
        right[:, i] = np.bincount(slab, weights=weight * columns[i] * fit.residual_mm, minlength=count)
        for j in range(i + 1):
            total = np.bincount(slab, weights=weight * columns[i] * columns[j], minlength=count)
            normal[:, i, j] = normal[:, j, i] = total
    good = wanted & (np.linalg.eigvalsh(normal)[:, 0] > 1e-4 * np.maximum(normal[:, 0, 0], 1e-9))
    change, covariance = np.full((count, c), np.nan), np.full((count, c, c), np.nan)
    inverse = np.linalg.inv(normal[good])
    change[good] = np.einsum("mij,mj->mi", inverse, right[good])
    left = fit.residual_mm - np.einsum("cn,nc->n", columns, change[slab])
    left = np.abs(left[(weight > 0) & np.isfinite(left)])
    covariance[good] = (robust_std(left) if len(left) else 0.0) ** 2 * inverse
    return change, covariance


def oval(fit: CableFit) -> Oval:
    """Fit circle, centre and the second harmonic of the radius over the angle, for all sections together.

    The scan must show half the circumference or more: on less, the oval, the centre and the radius cannot be told apart,
    and `amplitude_std_mm` says so.
    """
    angle = _angles(fit)
    columns = np.stack(
        [np.ones_like(angle), np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1
    )
    change, inverse, scale = np.zeros(5), np.zeros((5, 5)), 0.0
    for _ in range(5):  # the oval must not count as noise, nor its poles as outliers
        left = fit.residual_mm - columns @ change
        scale = robust_std(left)
        weight = tukey(left, scale)
        inverse = np.linalg.pinv(columns.T @ (weight[:, None] * columns))
        change = inverse @ (columns.T @ (weight * fit.residual_mm))
    cosine, sine = change[3], change[4]
    amplitude = float(np.hypot(cosine, sine))
    mean = 2 * (fit.radius_mm + float(change[0]))
    spread = scale * np.sqrt(np.diag(inverse))
    return Oval(
        diameter_mm=mean,
        std_mm=2 * float(spread[0]),
        minimum_mm=mean - 2 * amplitude,
        maximum_mm=mean + 2 * amplitude,
        amplitude_std_mm=4 * float(max(spread[3], spread[4])),
        direction_deg=float(np.degrees(np.arctan2(sine, cosine) / 2)),
    )
