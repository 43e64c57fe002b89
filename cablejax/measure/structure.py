"""What the residuals of a fit say about the surface: errors that neighbours share, and faces that are flat.

Noise differs from point to point. What neighbouring points have in common is the scanner's own error on that surface, a
filter's, or the thing's own shape; it does not average out, and a part of it always looks like another radius.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from cablejax.measure.fit import CableFit
from cablejax.measure.sections import BIN_DEG, bins_of

NEIGHBORS = 4
UNSEEN = 0.4  # of the shared errors: what of them looks like another radius
SURE = 2.0  # standard deviations of a correlation made by chance, which are no structure
CLEAR = 3.5  # standard deviations from the surface, within which points take part


def shared_mm(fit: CableFit, sweep: Int[np.ndarray, " n"] | None) -> tuple[float, float]:
    """Standard deviation of the errors that neighbours share, and what they leave open in the radius.

    The mean product of neighbours' residuals is the variance of what they share (a variogram's sill less its nugget). Where
    sweeps are known, neighbours of different sweeps are looked at: what is shared within one is part of the fit. Patterns
    that the fit takes up cannot be seen, and one that looks like another radius is among them: it is taken to hold `UNSEEN`
    of the standard deviation of those that can. A short arc shows little of such a pattern: 1 less its projection on the
    shift of the centre.

    Args:
        fit: The fit of axis and radius.
        sweep: The sweep of each point, None if unknown.
    """
    used = np.flatnonzero(fit.weight > 0)
    residual, angle = fit.residual_mm[used], np.arctan2(fit.place.v[used], fit.place.u[used])
    residual = residual - residual.mean()
    count = min((NEIGHBORS if sweep is None else 3 * NEIGHBORS) + 1, len(residual))
    # Neighbours on the surface: points that are near in space are alike in their distance from it, noise or not.
    on = np.stack([fit.place.s[used], fit.radius_mm * np.cos(angle), fit.radius_mm * np.sin(angle)], axis=1)
    _, near = KDTree(on).query(on, k=count, workers=-1)
    near = np.asarray(near)[:, 1:]
    product = residual[:, None] * residual[near]
    other = np.ones(near.shape, dtype=bool) if sweep is None else sweep[used][:, None] != sweep[used][near]
    variance = float(np.mean(residual**2))
    chance = SURE * variance / np.sqrt(len(residual))
    together = float(product[other].mean()) - chance if other.any() else 0.0
    shared = float(np.sqrt(max(together, 0.0)))
    columns = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    gain = float(np.sqrt(np.linalg.pinv(columns @ columns.T / len(angle))[0, 0]))
    return shared, UNSEEN * shared * gain


def flat_faces(fit: CableFit, arc_deg: float) -> int | None:
    """How many flat faces explain the section better than a circle does; None where the circle is better.

    As many faces as there are quarters of a circle in the arc, two at least: the edge of a box, a bar, a ridge. They are
    found by dynamic programming over the directions, each face the line of least squares through its points.

    Args:
        fit: The fit of axis and radius.
        arc_deg: Circumference seen.
    """
    near = np.abs(fit.residual_mm) < CLEAR * fit.noise_mm
    u, v = fit.place.u[near], fit.place.v[near]
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
    return faces if least[-1] < float(np.sum(fit.residual_mm[near] ** 2)) else None


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
