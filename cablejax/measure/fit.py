"""Axis curve and radius fitted together to all points of a cable: least squares in cable coordinates.

A short arc says little about where one section's centre lies, and so little about its radius. The curvature of the
surface seen in all sections together says much: one radius and a smooth axis are fitted at once, so that an arc of
60 degrees widens the interval and does not move the radius.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from cablejax.measure.axis import Axis, Place, locate, sampled, trimmed
from cablejax.measure.errors import MeasureError

TUKEY = 4.685  # standard deviations; 95 % efficient where the noise is Gaussian
SECTOR_DEG = 15.0
OUTER = 6


class CableFit(NamedTuple):
    """One radius about one smooth curve.

    Attributes:
        axis: The curve.
        radius_mm: The radius, of least squares with Tukey's weights.
        noise_mm: Robust standard deviation of the residuals.
        random_mm: Standard deviation of the radius if residuals are independent.
        clustered_mm: The same if they are independent only between patches (`SECTOR_DEG` wide, a diameter long).
        place: Cable coordinates of the points given `[n]`.
        residual_mm: Their distance from the surface `[n]`, positive outside.
        weight: Tukey weights `[n]`, 0 for outliers.
    """

    axis: Axis
    radius_mm: float
    noise_mm: float
    random_mm: float
    clustered_mm: float
    place: Place
    residual_mm: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]


def _basis(s: np.ndarray, axis: Axis, knot_mm: float) -> csr_array:
    """B-splines at arc lengths `[n]`: cubic with a knot every `knot_mm`, or one straight piece for a short cable."""
    low, high = axis.s[0], axis.s[-1]
    pieces = int((high - low) // knot_mm)
    degree = 3 if pieces >= 2 else 1
    pieces = pieces if degree == 3 else 1
    knots = np.concatenate([np.full(degree, low), np.linspace(low, high, pieces + 1), np.full(degree, high)])
    return csr_array(BSpline.design_matrix(np.clip(s, low, high), knots, degree))


def _columns(basis: csr_array) -> int:
    shape = basis.shape
    assert shape is not None
    return int(shape[1])


def _scale(residual: np.ndarray, radius: float) -> float:
    """Robust standard deviation about zero, so that a start off by more than the noise keeps its points; a millionth of
    the radius at least, to which float32 coordinates are rounded."""
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-6 * radius)


def _normal(basis: csr_array, cos: np.ndarray, sin: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The normal matrix of (offsets a, offsets b, radius), dense: its size is a few hundred at most."""
    m = _columns(basis)
    normal = np.zeros((2 * m + 1, 2 * m + 1))
    for row, first in enumerate((cos, sin)):
        for column, second in enumerate((cos, sin)):
            block = basis.T @ basis.multiply((weight * first * second)[:, None]).tocsr()
            normal[row * m : (row + 1) * m, column * m : (column + 1) * m] = block.toarray()
        edge = basis.T @ (weight * first)
        normal[row * m : (row + 1) * m, -1] = edge
        normal[-1, row * m : (row + 1) * m] = edge
    normal[-1, -1] = weight.sum()
    return normal


def _smoothing(m: int, points: float) -> np.ndarray:
    """A faint pull on the offsets and their second differences, so that a gap in the scan does not leave the axis loose.

    It weighs 1e-4 of a knot's share of the points; the pull to no change at all a ten-thousandth of that.
    """
    strength = 1e-4 * points / m
    penalty = np.diag(np.append(np.full(2 * m, 1e-4 * strength), 0.0))
    if m > 2:
        difference = np.diff(np.eye(m), n=2, axis=0)
        block = strength * difference.T @ difference
        penalty[:m, :m] += block
        penalty[m : 2 * m, m : 2 * m] += block
    return penalty


def _moved(axis: Axis, basis_at_samples: csr_array, change: np.ndarray) -> Axis:
    m = _columns(basis_at_samples)
    a, b = basis_at_samples @ change[:m], basis_at_samples @ change[m : 2 * m]
    step = axis.s[1] - axis.s[0]
    return sampled(axis.xyz + a[:, None] * axis.across + b[:, None] * axis.binormal(), step=step)


def tukey(residual: Float[np.ndarray, " n"], scale: float) -> Float[np.ndarray, " n"]:
    """Tukey's biweight: near 1 for small residuals, 0 beyond `TUKEY` standard deviations."""
    ratio = residual / (TUKEY * scale)
    return np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)


def _clustered(fit_rows: csr_array, cos, sin, influence, inverse_row, patches) -> float:
    """Standard deviation of the radius with residuals summed over patches first (a sandwich estimate)."""
    m = _columns(fit_rows)
    lever = -(cos * (fit_rows @ inverse_row[:m]) + sin * (fit_rows @ inverse_row[m : 2 * m]) + inverse_row[-1])
    sums = np.bincount(patches, weights=lever * influence)
    return float(np.sqrt(np.sum(sums**2)))


def fit_cable(xyz: Float[np.ndarray, "n 3"], axis: Axis, radius_mm: float, *, knot_diameters: float = 1.0) -> CableFit:
    """Fit one radius and a smooth axis to points that are mostly the cable's.

    Gauss-Newton on the distance to the axis, with Tukey's weights from the residuals' own scale. Between iterations the
    points are located anew on the moved axis.

    Args:
        xyz: Points `[n, 3]`, mm.
        axis: A curve within a fraction of the radius of the true one.
        radius_mm: Where to begin.
        knot_diameters: Distance between knots of the axis, in diameters. Cubic splines one diameter apart follow a bend
            of 15 diameters to 4e-6 of the diameter.

    Raises:
        MeasureError: If fewer points keep weight than the fit has unknowns.
    """
    radius = radius_mm
    knot = knot_diameters * 2 * radius_mm
    for _ in range(OUTER):
        ends = locate(axis, xyz).s
        axis = trimmed(axis, float(ends.min()), float(ends.max()))
        place = locate(axis, xyz)
        basis = _basis(place.s, axis, knot)
        m = _columns(basis)
        distance = np.maximum(np.hypot(place.u, place.v), 1e-9)
        cos, sin = place.u / distance, place.v / distance
        change = np.zeros(2 * m + 1)
        residual = distance - radius
        for _ in range(4):
            scale = _scale(residual, radius)
            weight = tukey(residual, scale)
            if weight.sum() < 2 * m + 1:
                raise MeasureError("No cable found: the points do not lie on one smooth round surface.")
            normal = _normal(basis, cos, sin, weight) + _smoothing(m, weight.sum())
            bent = np.concatenate([basis.T @ (weight * cos * residual), basis.T @ (weight * sin * residual)])
            change += np.linalg.solve(normal, np.append(bent, (weight * residual).sum()))
            du, dv = place.u - basis @ change[:m], place.v - basis @ change[m : 2 * m]
            moved = np.maximum(np.hypot(du, dv), 1e-9)
            cos, sin = du / moved, dv / moved
            residual = moved - radius - change[-1]
        radius += float(change[-1])
        axis = _moved(axis, _basis(axis.s, axis, knot), change)
        if np.abs(change).max() < 1e-5 * radius:
            break
    return _finished(xyz, axis, radius, knot)


def _finished(xyz: np.ndarray, axis: Axis, radius: float, knot: float) -> CableFit:
    """Residuals, weights and the radius's standard deviations at the solution."""
    place = locate(axis, xyz)
    basis = _basis(place.s, axis, knot)
    m = _columns(basis)
    distance = np.maximum(np.hypot(place.u, place.v), 1e-9)
    cos, sin, residual = place.u / distance, place.v / distance, distance - radius
    scale = _scale(residual, radius)
    weight = tukey(residual, scale)
    normal = _normal(basis, cos, sin, weight) + _smoothing(m, weight.sum())
    inverse_row = np.linalg.solve(normal, np.eye(2 * m + 1)[-1])
    influence = weight * residual
    spread = float(np.sqrt(np.sum(weight * influence * residual) / max(weight.sum(), 1e-9)))
    lever = cos * (basis @ inverse_row[:m]) + sin * (basis @ inverse_row[m : 2 * m]) + inverse_row[-1]
    random = float(np.sqrt(np.sum((lever * influence) ** 2)))
    sector = np.floor((np.degrees(np.arctan2(place.v, place.u)) + 180) / SECTOR_DEG).astype(int)
    slab = np.floor((place.s - place.s.min()) / (2 * radius)).astype(int)
    patches = slab * int(360 / SECTOR_DEG + 1) + sector
    clustered = _clustered(basis, cos, sin, influence, inverse_row, patches)
    return CableFit(axis, radius, max(scale, spread), random, clustered, place, residual, weight)
