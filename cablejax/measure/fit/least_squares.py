"""Axis curve and radius fitted together to all points of a cable: least squares in cable coordinates.

A short arc says little about where one section's centre lies, and so little about its radius. The curvature of the
surface seen in all sections together says much: one radius and a smooth axis are fitted at once, so that an arc of
60 degrees widens the interval and does not move the radius.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, hstack

from cablejax.geometry.robust import robust_std
from cablejax.measure.errors import NoCableError
from cablejax.measure.fit.axis import Axis, Place, locate, sampled, trimmed

TUKEY = 4.685  # standard deviations; 95 % efficient where the noise is Gaussian
SECTOR_DEG = 15.0
OUTER = 6
PER_UNKNOWN = 3  # points for each number that is fitted
FURTHEST = 4.0  # radii that an axis may move at once: it began within a fraction of one
WINDS = "No cable found: a curve through what is roundest winds to and fro, and follows nothing."
RUNAWAY = 1.5  # times as long as it began, beyond which an axis winds through its points and follows nothing
PER_KNOT = 16  # cells in a knot: the splines change by 1e-3 of themselves within one


class CableFit(NamedTuple):
    """One radius about one smooth curve.

    Attributes:
        axis: The curve.
        radius_mm: The radius, of least squares with Tukey's weights.
        noise_mm: Robust standard deviation of the residuals.
        random_mm: Standard deviation of the radius if residuals are independent.
        clustered_mm: The same if they are independent only between patches (`SECTOR_DEG` wide, a diameter long).
        place: Cable coordinates of the points given `[n]`, shifts of stations taken off.
        residual_mm: Their distance from the surface `[n]`, positive outside.
        weight: Tukey weights `[n]`, 0 for outliers.
        influence: How far each point's residual moves the radius `[n]`.
    """

    axis: Axis
    radius_mm: float
    noise_mm: float
    random_mm: float
    clustered_mm: float
    place: Place
    residual_mm: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    influence: Float[np.ndarray, " n"]


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
    return max(robust_std(residual), 1e-6 * radius)


def _sums(cells: "_Cells", *values: np.ndarray) -> list[np.ndarray]:
    return [np.bincount(cells.row, weights=value, minlength=len(cells.columns)) for value in values]


def _normal(cells: "_Cells", cos: np.ndarray, sin: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The normal matrix of (offsets a, offsets b, radius), dense: its size is a few hundred at most.

    Points of a cell share their splines' values, so its sums stand for them.
    """
    m = cells.columns.shape[1]
    normal = np.zeros((2 * m + 1, 2 * m + 1))
    weighted = (weight * cos, weight * sin)
    cc, cs, ss, c, s = _sums(cells, weighted[0] * cos, weighted[0] * sin, weighted[1] * sin, *weighted)
    for row, column, total in ((0, 0, cc), (0, 1, cs), (1, 0, cs), (1, 1, ss)):
        normal[row * m : (row + 1) * m, column * m : (column + 1) * m] = cells.columns.T @ (
            total[:, None] * cells.columns
        )
    edge = np.concatenate([cells.columns.T @ c, cells.columns.T @ s])
    normal[:-1, -1] = normal[-1, :-1] = edge
    normal[-1, -1] = weight.sum()
    return normal


def _smoothing(m: int, stations: int, points: float) -> np.ndarray:
    """A faint pull on the offsets and their second differences, so that a gap in the scan does not leave the axis loose.

    It weighs 1e-4 of a knot's share of the points; the pull to no change at all a ten-thousandth of that. Shifts of
    stations are pulled to zero with 1e-3 of their share, which decides what an axis and its stations have in common.
    """
    strength = 1e-4 * points / m
    block = np.diag(np.append(np.full(m, 1e-4 * strength), np.full(stations, 1e-3 * points / max(stations, 1))))
    if m > 2:
        difference = np.diff(np.eye(m), n=2, axis=0)
        block[:m, :m] += strength * difference.T @ difference
    width = m + stations
    penalty = np.zeros((2 * width + 1, 2 * width + 1))
    penalty[:width, :width] = block
    penalty[width : 2 * width, width : 2 * width] = block
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


def _slope(residual: np.ndarray, scale: float) -> np.ndarray:
    """Derivative of `tukey` times the residual: how an estimate moves with a point is its weight over the mean of these."""
    square = (residual / (TUKEY * scale)) ** 2
    return np.where(square < 1, (1 - square) * (1 - 5 * square), 0.0)


class _Cells(NamedTuple):
    """Points gathered in stretches of a `PER_KNOT`th of a knot, apart by station: the cell of each `[n]`, and each cell's
    values of the columns `[cells, splines + stretches]`, at the mean arc length of its points."""

    row: np.ndarray
    columns: np.ndarray


def _cells(s: np.ndarray, axis: Axis, knot: float, block: np.ndarray | None) -> _Cells:
    stretch = knot if np.isfinite(knot) else axis.length_mm
    bins = np.floor((s - s.min()) / (stretch / PER_KNOT)).astype(np.int64)
    key = bins if block is None else block * (int(bins.max()) + 1) + bins
    names, row = np.unique(key, return_inverse=True)
    mean = np.bincount(row, weights=s) / np.bincount(row)
    columns = _basis(mean, axis, knot).toarray()
    if block is not None:
        shifts = np.zeros((len(names), int(block.max()) + 1))
        shifts[np.arange(len(names)), names // (int(bins.max()) + 1)] = 1.0
        columns = np.concatenate([columns, shifts], axis=1)
    return _Cells(row, columns)


class _Design(NamedTuple):
    """What a point's offset consists of: the axis's splines, then one column for each stretch of a station.

    Attributes:
        place: Cable coordinates of the points.
        columns: Values `[n, splines + stretches]`, for the offsets along either frame vector.
        cells: The same in short stretches of the length, for sums.
        splines: How many columns are the axis's.
    """

    place: Place
    columns: csr_array
    cells: _Cells
    splines: int

    @property
    def stretches(self) -> int:
        """How many columns are shifts of stations."""
        return _columns(self.columns) - self.splines


def _design(xyz: np.ndarray, axis: Axis, knot: float, block: np.ndarray | None) -> _Design:
    place = locate(axis, xyz)
    basis = _basis(place.s, axis, knot)
    splines = _columns(basis)
    if block is not None:
        rows = np.arange(len(xyz))
        shifts = csr_array((np.ones(len(xyz)), (rows, block)), shape=(len(xyz), int(block.max()) + 1))
        basis = csr_array(hstack([basis, shifts], format="csr"))
    return _Design(place, basis, _cells(place.s, axis, knot, block), splines)


def _polar(design: _Design, change: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, cosine and sine of the points about the axis moved by `change`."""
    width = _columns(design.columns)
    u = design.place.u - design.columns @ change[:width]
    v = design.place.v - design.columns @ change[width : 2 * width]
    distance = np.maximum(np.hypot(u, v), 1e-9)
    return distance, u / distance, v / distance


def _solve(design: _Design, radius: float, change: np.ndarray, inlier: np.ndarray) -> np.ndarray:
    """At most four reweighted Gauss-Newton steps on (offsets along u, offsets along v, radius)."""
    for _ in range(4):
        distance, cos, sin = _polar(design, change)
        residual = distance - radius - change[-1]
        weight = inlier * tukey(residual, _scale(residual, radius))
        if weight.sum() < len(change):
            raise NoCableError("No cable found: the points do not lie on one smooth round surface.")
        pull = _smoothing(design.splines, design.stretches, weight.sum())
        sums = _sums(design.cells, weight * cos * residual, weight * sin * residual)
        pulled = np.concatenate([design.cells.columns.T @ total for total in sums])
        right = np.append(pulled, (weight * residual).sum()) - pull @ change
        step = np.linalg.solve(_normal(design.cells, cos, sin, weight) + pull, right)
        change = change + step
        if np.abs(step).max() < 1e-6 * radius:
            break
    return change


def fit_cable(
    xyz: Float[np.ndarray, "n 3"],
    axis: Axis,
    radius_mm: float,
    *,
    knot_diameters: float = 1.0,
    block: Int[np.ndarray, " n"] | None = None,
    inlier: Bool[np.ndarray, " n"] | None = None,
) -> CableFit:
    """Fit one radius and a smooth axis to points that are mostly the cable's.

    Gauss-Newton on the distance to the axis, with Tukey's weights from the residuals' own scale. Between iterations the
    points are located anew on the moved axis.

    Args:
        xyz: Points `[n, 3]`, mm.
        axis: A curve within a fraction of the radius of the true one.
        radius_mm: Where to begin.
        knot_diameters: Distance between knots of the axis, in diameters. Cubic splines one diameter apart follow a bend
            of 15 diameters to 4e-6 of the diameter. Infinite for a straight axis.
        block: Number of the stretch of a station that each point belongs to `[n]`, from 0 without gaps. Each stretch gets
            a shift of its own across the cable.
        inlier: Which points the fit takes `[n]`; all if None.

    Raises:
        MeasureError: If there are fewer than `PER_UNKNOWN` points for each unknown, fewer keep weight than there are
            unknowns, the radius falls below zero, or the axis runs away.
    """
    radius = radius_mm
    knot = knot_diameters * 2 * radius_mm
    shifts: np.ndarray | None = None
    inlier = np.ones(len(xyz)) if inlier is None else inlier.astype(float)
    longest = np.inf
    for turn in range(OUTER):
        ends = locate(axis, xyz).s
        axis = trimmed(axis, float(ends.min()), float(ends.max()))
        if turn == 0:
            longest = RUNAWAY * axis.length_mm + 4 * radius_mm
        if axis.length_mm > longest:
            raise NoCableError(
                "No cable found: a curve through what is roundest winds to and fro, and follows nothing."
            )
        design = _design(xyz, axis, knot, block)
        _check_points(design, inlier)
        m, width = design.splines, _columns(design.columns)
        start = np.zeros(2 * width + 1)
        if shifts is not None:
            start[m:width], start[width + m : 2 * width] = shifts
        change = _solve(design, radius, start, inlier)
        radius += float(change[-1])
        if not radius > 0:
            raise NoCableError(
                "No cable found: what is roundest is curved the other way round, or no more than its noise."
            )
        shifts = np.stack([change[m:width], change[width + m : 2 * width]])
        bend = np.concatenate([change[:m], change[width : width + m]])
        if np.abs(bend).max() > FURTHEST * radius_mm:
            raise NoCableError(WINDS)
        axis = _moved(axis, _basis(axis.s, axis, knot), bend)
        if max(np.abs(bend).max(), abs(change[-1])) < 1e-5 * radius:
            break
    design = _design(xyz, axis, knot, block)
    _check_points(design, inlier)
    return _finished(design, axis, radius, shifts, inlier)


def _check_points(design: _Design, inlier: np.ndarray) -> None:
    """Refuse a curve through a handful of points: with enough freedom it goes through any."""
    unknowns = 2 * _columns(design.columns) + 1
    if inlier.sum() < PER_UNKNOWN * unknowns:
        raise NoCableError(
            f"Too few points on the cable: {inlier.sum():.0f} over {np.ptp(design.place.s):.3g} mm, where at least "
            f"{PER_UNKNOWN * unknowns} are needed to follow its axis."
        )


def _finished(design: _Design, axis: Axis, radius: float, shifts: np.ndarray | None, inlier: np.ndarray) -> CableFit:
    """Residuals, weights and the radius's standard deviations at the solution."""
    m, width = design.splines, _columns(design.columns)
    still = np.zeros(2 * width + 1)
    if shifts is not None:
        still[m:width], still[width + m : 2 * width] = shifts
    distance, cos, sin = _polar(design, still)
    residual = distance - radius
    scale = _scale(residual, radius)
    weight = inlier * tukey(residual, scale)
    basis = design.columns
    normal = _normal(design.cells, cos, sin, weight) + _smoothing(m, design.stretches, weight.sum())
    row = np.linalg.solve(normal, np.eye(2 * width + 1)[-1])
    spread = float(np.sqrt(np.sum((weight * residual) ** 2) / max(weight.sum(), 1e-9)))
    # How far each point's residual moves the radius: summed one by one, and over patches first (a sandwich estimate).
    gain = weight * weight.sum() / np.sum(inlier * _slope(residual, scale))
    along_u, along_v = basis @ row[:width], basis @ row[width : 2 * width]
    influence = gain * (cos * along_u + sin * along_v + row[-1])
    pull = influence * residual
    sector = np.floor((np.degrees(np.arctan2(sin, cos)) + 180) / SECTOR_DEG).astype(int)
    slab = np.floor((design.place.s - design.place.s.min()) / (2 * radius)).astype(int)
    patches = np.bincount(slab * int(360 / SECTOR_DEG + 1) + sector, weights=pull)
    place = Place(design.place.s, distance * cos, distance * sin)
    return CableFit(
        axis=axis,
        radius_mm=radius,
        noise_mm=max(scale, spread),
        random_mm=float(np.linalg.norm(pull)),
        clustered_mm=float(np.linalg.norm(patches)),
        place=place,
        residual_mm=residual,
        weight=weight,
        influence=influence,
    )
