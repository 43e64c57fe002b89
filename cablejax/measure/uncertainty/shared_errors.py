"""Errors that neighbouring points share, from the residuals of a fit.

Noise differs from point to point. What neighbouring points have in common is the scanner's own error on that surface, a
filter's, or the thing's own shape; it does not average out, and a part of it always looks like another radius.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.shape.sections import BIN_DEG, bins_of

NEIGHBORS = 4
UNSEEN = 0.4  # of the shared errors: what of them looks like another radius
FEW = 0.1  # of the fullest directions' points, below which a direction was not seen
LEAST_POINTS = 12  # of a stretch, for its own arc to be looked at
SURE = 2.0  # standard deviations of a correlation made by chance, which are no structure


def shared_mm(
    fit: CableFit, sweep: Int[np.ndarray, " n"] | None, *, residual_mm: Float[np.ndarray, " n"] | None = None
) -> tuple[float, float]:
    """Standard deviation of the errors that neighbours share, and what they leave open in the radius.

    The mean product of neighbours' residuals is the variance of what they share (a variogram's sill less its nugget). Where
    sweeps are known, neighbours of different sweeps are looked at: what is shared within one is part of the fit. Patterns
    that the fit takes up cannot be seen, and one that looks like another radius is among them: it is taken to hold `UNSEEN`
    of the standard deviation of those that can. A short arc shows little of such a pattern: 1 less its projection on the
    shift of the centre.

    Args:
        fit: The fit of axis and radius.
        sweep: The sweep of each point, None if unknown.
        residual_mm: Distances from the surface `[n]`, where another one than the fit's radius is known; its own if None.
    """
    residual_mm = fit.residual_mm if residual_mm is None else residual_mm
    used = np.flatnonzero(fit.weight > 0)
    residual, angle = residual_mm[used], np.arctan2(fit.place.v[used], fit.place.u[used])
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
    along = fit.place.s[used] - fit.place.s[used].min()
    stretches = max(1, round(float(along.max()) / (2 * fit.radius_mm)))
    stretch = np.minimum((along / max(along.max(), 1e-9) * stretches).astype(int), stretches - 1)
    return shared, UNSEEN * shared * _gain(angle, stretch)


def _gain(angle: Float[np.ndarray, " n"], stretch: Int[np.ndarray, " n"]) -> float:
    """How much of a pattern on the surface that looks like another radius stays open when the centre is free.

    Stray points beyond the arc that is seen would make it look well known: directions with few points do not count. A scan that
    shows another side of each stretch shows a large arc in all, of which none tells a radius: the middle one of the stretches
    counts where it leaves more open.

    Args:
        angle: Of each point about the axis, radians.
        stretch: Number of the stretch, about a diameter long, that each lies in.
    """
    bins = bins_of(angle)
    counts = np.bincount(bins, minlength=int(360 / BIN_DEG))
    clear = (counts > FEW * np.sort(counts)[-8:].mean())[bins]
    columns = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])[:, clear]
    _, number = np.unique(stretch[clear], return_inverse=True)
    products = (columns[:, None] * columns[None]).reshape(9, -1)
    sums = np.stack([np.bincount(number, weights=one) for one in products], axis=1).reshape(-1, 3, 3)
    whole = _open(sums.sum(axis=0))
    single = [_open(one) for one in sums if one[0, 0] >= LEAST_POINTS]
    return max(whole, float(np.quantile(single or [whole], 0.5, method="lower")))


def _open(sums: Float[np.ndarray, "3 3"]) -> float:
    """Standard deviation of the constant beside sine and cosine, from their sums of products, for residuals of one."""
    return float(np.sqrt(np.linalg.pinv(sums / sums[0, 0])[0, 0]))
