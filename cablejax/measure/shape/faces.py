"""Flat faces: boxes, edges and bars, which a circle explains worse than as many straight lines as it has quarters."""

import numpy as np
from jaxtyping import Bool, Float

from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.shape.sections import BIN_DEG, bins_of

CLEAR = 3.5  # standard deviations from the surface, within which points take part


def flat_faces(fit: CableFit, arc_deg: float) -> int | None:
    """How many flat faces explain the section better than a circle does; None where the circle is better.

    As many faces as there are quarters of a circle in the arc, two at least: the edge of a box, a bar, a ridge. They are
    found by dynamic programming over the directions, each face the line of least squares through its points. What tapers is
    brought to one size first: the mean section of a long stem is neither round nor flat.

    Args:
        fit: The fit of axis and radius.
        arc_deg: Circumference seen.
    """
    near = np.abs(fit.residual_mm) < CLEAR * fit.noise_mm
    scale = _evened(fit)[near]
    u, v = fit.place.u[near] * scale, fit.place.v[near] * scale
    bins = bins_of(np.arctan2(v, u))
    width = int(360 / BIN_DEG)
    seen = np.bincount(bins, minlength=width) > 0
    moments = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    sums = np.stack([np.bincount(bins, weights=one, minlength=width) for one in moments])
    first = _after_the_widest_gap(seen)
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(np.roll(sums, -first, axis=1), axis=1)], axis=1)
    faces = max(2, round(arc_deg / 90))
    least = _line_sums(sums)[0]
    for _ in range(faces - 1):
        least = np.min(least[:, None] + _line_sums(sums), axis=0)
    return faces if least[-1] < float(np.sum((np.hypot(u, v) - fit.radius_mm) ** 2)) else None


def _evened(fit: CableFit) -> Float[np.ndarray, " n"]:
    """The radius over that of a straight taper at each point; 1 where the taper is none, or would come to a point."""
    weight, along = fit.weight / fit.weight.sum(), fit.place.s
    off_along, off = along - weight @ along, fit.residual_mm - weight @ fit.residual_mm
    slope = float((weight * off_along) @ off / max(weight @ off_along**2, 1e-12))
    there = fit.radius_mm + slope * off_along
    return fit.radius_mm / there if there.min() > 0.5 * fit.radius_mm else np.ones_like(along)


def _after_the_widest_gap(seen: Bool[np.ndarray, " bins"]) -> int:
    """The first bin after the longest run of empty ones around the circle."""
    rows = np.flatnonzero(seen)
    gaps = np.diff(np.append(rows, rows[0] + len(seen)))
    return int(rows[(int(np.argmax(gaps)) + 1) % len(rows)])


def _line_sums(sums: Float[np.ndarray, "6 b"]) -> Float[np.ndarray, "b b"]:
    """Sum of squared distances from the best line of the points between any two bins `[from, to]`; infinite backwards."""
    n, u, v, uu, uv, vv = sums[:, None, :] - sums[:, :, None]
    safe = np.maximum(n, 1.0)
    a, b, c = uu - u * u / safe, uv - u * v / safe, vv - v * v / safe
    least = np.maximum(0.5 * (a + c) - np.hypot(0.5 * (a - c), b), 0.0)
    return np.where(np.tri(len(n), dtype=bool).T, least, np.inf)
