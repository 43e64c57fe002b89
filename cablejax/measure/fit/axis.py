"""A smooth curve through the middle of a cable, with a frame that does not twist, and cable coordinates about it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline, make_lsq_spline
from scipy.spatial import KDTree

from cablejax.measure.find.cylinder import frame


class Place(NamedTuple):
    """Cable coordinates of points: arc length `[n]` and the offsets `[n]` along the two frame vectors there, in mm."""

    s: Float[np.ndarray, " n"]
    u: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]


class Axis(NamedTuple):
    """A curve, sampled evenly by arc length.

    Attributes:
        s: Arc length of each sample `[m]`, mm.
        xyz: Samples `[m, 3]`, mm.
        tangent: Unit tangents `[m, 3]`.
        across: Unit vectors `[m, 3]` square to the tangent, carried along without twist; the second frame vector is
            `cross(tangent, across)`.
    """

    s: Float[np.ndarray, " m"]
    xyz: Float[np.ndarray, "m 3"]
    tangent: Float[np.ndarray, "m 3"]
    across: Float[np.ndarray, "m 3"]

    @property
    def length_mm(self) -> float:
        """Length of the curve."""
        return float(self.s[-1] - self.s[0])

    def at(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Points of the curve at arc lengths `[n]`, linear between the samples."""
        return np.stack([np.interp(s, self.s, self.xyz[:, axis]) for axis in range(3)], axis=1)

    def binormal(self) -> Float[np.ndarray, "m 3"]:
        """The second frame vector at each sample."""
        return np.cross(self.tangent, self.across)


def _carry(tangent: np.ndarray) -> np.ndarray:
    """A rotation-minimising frame: the first vector, carried from sample to sample by the least rotation."""
    across = np.empty_like(tangent)
    across[0] = frame(tangent[0])[0]
    for row in range(1, len(tangent)):
        step = across[row - 1] - (across[row - 1] @ tangent[row]) * tangent[row]
        across[row] = step / np.linalg.norm(step)
    return across


def sampled(xyz: Float[np.ndarray, "m 3"], *, step: float) -> Axis:
    """A curve through ordered points, sampled anew every `step` mm; cubic where four points or more are given."""
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=1))])
    spline = make_interp_spline(chord, xyz, k=3 if len(xyz) >= 4 else 1)
    dense = spline(np.linspace(0, chord[-1], 8 * len(xyz)))
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    s = np.linspace(0, arc[-1], max(3, int(np.ceil(arc[-1] / step)) + 1))
    t = np.interp(s, arc, np.linspace(0, chord[-1], 8 * len(xyz)))
    tangent = spline(t, 1)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    return Axis(s, spline(t), tangent, _carry(tangent))


def smoothed(xyz: Float[np.ndarray, "m 3"], *, knot_mm: float, step: float, extend_mm: float = 0.0) -> Axis:
    """A curve near ordered points: a straight line for a short way, else a cubic spline with a knot every `knot_mm`."""
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=1))])
    length = chord[-1]
    pieces = int(length // knot_mm)
    degree = 3 if pieces >= 2 and len(xyz) >= 2 * pieces + 4 else 1
    pieces = pieces if degree == 3 else 1
    inner = np.linspace(0, length, pieces + 1)[1:-1]
    knots = np.concatenate([np.zeros(degree + 1), inner, np.full(degree + 1, length)])
    spline = make_lsq_spline(chord, xyz, knots, k=degree)
    curve = spline(np.linspace(0, length, max(4, int(np.ceil(length / step)) + 1)))
    if extend_mm > 0:
        curve = _extended(curve, extend_mm, step)
    return sampled(curve, step=step)


def _extended(curve: np.ndarray, extra: float, step: float) -> np.ndarray:
    """The curve continued straight at both ends: the track's last window reaches beyond its last centre."""
    first, last = curve[0] - curve[1], curve[-1] - curve[-2]
    ways = np.linspace(extra, 0, max(2, int(np.ceil(extra / step))), endpoint=False)
    head = curve[0] + np.outer(ways, first / np.linalg.norm(first))
    tail = curve[-1] + np.outer(ways[::-1], last / np.linalg.norm(last))
    return np.concatenate([head, curve, tail])


def trimmed(axis: Axis, low: float, high: float) -> Axis:
    """The part of a curve between two arc lengths, which may lie beyond its ends; its own arc length begins at 0."""
    step = float(axis.s[1] - axis.s[0])
    s = np.linspace(low, high, max(4, int(np.ceil((high - low) / step)) + 1))
    row = np.clip(np.floor(s / step).astype(int), 0, len(axis.s) - 2)
    return sampled(_hermite(axis, row, (s / step - row)[:, None], step), step=step)


def locate(axis: Axis, xyz: Float[np.ndarray, "n 3"]) -> Place:
    """Cable coordinates of points `[n, 3]`: the foot of the perpendicular on the curve, and the offset in its frame.

    The nearest sample, then one Newton step to the foot with the curvature between the neighbours taken into account by
    a second look at the interpolated curve. Points beyond an end get the arc length of their foot on its tangent.
    """
    nearest = np.asarray(KDTree(axis.xyz).query(xyz, workers=-1)[1])
    s = axis.s[nearest] + np.einsum("ij,ij->i", xyz - _rows(axis.xyz, nearest), _rows(axis.tangent, nearest))
    for _ in range(2):
        base, tangent = _line_at(axis, *_between(axis, s))
        s = s + np.einsum("ij,ij->i", xyz - base, tangent)
    base, tangent, across = _frame_at(axis, s)
    offset = xyz - base
    offset = offset - np.einsum("ij,ij->i", offset, tangent)[:, None] * tangent
    u, v = np.einsum("ij,ij->i", offset, across), np.einsum("ij,ij->i", offset, np.cross(tangent, across))
    return Place(s, u, v)


def point_at(axis: Axis, place: Place) -> Float[np.ndarray, "n 3"]:
    """Points `[n, 3]` at cable coordinates, the inverse of `locate`."""
    base, tangent, across = _frame_at(axis, place.s)
    return base + place.u[:, None] * across + place.v[:, None] * np.cross(tangent, across)


def turns_by(axis: Axis, length_mm: float) -> Float[np.ndarray, " m"]:
    """The angle in radians by which the curve turns over a length, about each sample `[m]`: between the tangents at its ends."""
    step = float(axis.s[1] - axis.s[0])
    half = max(1, round(0.5 * length_mm / step))
    rows = np.arange(len(axis.s))
    before, after = np.maximum(rows - half, 0), np.minimum(rows + half, len(axis.s) - 1)
    cosine = np.einsum("ij,ij->i", axis.tangent[before], axis.tangent[after])
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def bearing(axis: Axis, s: Float[np.ndarray, " n"], point: Float[np.ndarray, "3"]) -> Float[np.ndarray, " n"]:
    """The angle in radians in the frame at arc lengths `[n]` under which a point lies, as `arctan2(v, u)` of a place."""
    base, tangent, across = _frame_at(axis, s)
    way = point - base
    return np.arctan2(np.einsum("ij,ij->i", way, np.cross(tangent, across)), np.einsum("ij,ij->i", way, across))


def _frame_at(axis: Axis, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point, tangent and first frame vector at arc lengths, between the samples and beyond the ends."""
    low, t = _between(axis, s)
    base, tangent = _line_at(axis, low, t)
    part = np.clip(t, 0, 1)
    across = (1 - part) * _rows(axis.across, low) + part * _rows(axis.across, low + 1)
    across = _unit(across - np.einsum("ij,ij->i", across, tangent)[:, None] * tangent)
    return base, tangent, across


def _between(axis: Axis, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sample before each arc length `[n]` and the share of the step from there `[n, 1]`, beyond 0 to 1 past the ends."""
    step = axis.s[1] - axis.s[0]
    low = np.clip(np.floor(s / step).astype(int), 0, len(axis.s) - 2)
    return low, (s / step - low)[:, None]


def _line_at(axis: Axis, low: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point and tangent between samples and beyond the ends."""
    part = np.clip(t, 0, 1)
    tangent = _unit((1 - part) * _rows(axis.tangent, low) + part * _rows(axis.tangent, low + 1))
    return _hermite(axis, low, t, axis.s[1] - axis.s[0]), tangent


def _rows(array: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows of an array; `array[at]` takes four times as long."""
    return np.take(array, at, axis=0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _hermite(axis: Axis, low: np.ndarray, t: np.ndarray, step: float) -> np.ndarray:
    """The curve between two samples from their places and tangents, cubic inside, straight outside."""
    inside = np.clip(t, 0, 1)
    p, q = _rows(axis.xyz, low), _rows(axis.xyz, low + 1)
    m, n = (step * _rows(axis.tangent, each) for each in (low, low + 1))
    square = inside * inside  # a power takes ten times as long
    cube = square * inside
    onward = 3 * square - 2 * cube
    curve = (1 - onward) * p + (cube - 2 * square + inside) * m + onward * q + (cube - square) * n
    beyond = (t != inside)[:, 0]
    if beyond.any():
        curve[beyond] += (t - inside)[beyond] * np.where(t < 0, m, n)[beyond]
    return curve
