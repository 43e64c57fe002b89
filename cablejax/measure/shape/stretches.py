"""A profile told as stretches of constant or tapering diameter, and the steps between them."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.geometry.robust import COVERAGE, robust_std
from cablejax.measure.shape.profile import Profile

LEAST_SHARE = 0.004  # of the diameter: less is no step of a cable, and sections of real scans wander by as much
PENALTY = 4.0  # times the logarithm of the number of sections, for each number more (Schwarz's criterion has 1)
SURE = 3.0  # standard deviations that a step or a taper must have
LEAST_SECTIONS = 3  # in a stretch
ONE = "one diameter"


class Stretch(NamedTuple):
    """A part of the length over which the diameter is constant, or changes evenly.

    Attributes:
        kind: "constant" or "tapering".
        from_mm, to_mm: Where it begins and ends along the axis.
        first_mm, last_mm: Diameter at either end.
        std_mm: Standard uncertainty of either.
    """

    kind: str
    from_mm: float
    to_mm: float
    first_mm: float
    last_mm: float
    std_mm: float

    @property
    def length_mm(self) -> float:
        """Its length along the axis."""
        return self.to_mm - self.from_mm

    @property
    def intervals_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The 95 % intervals of the diameter at both ends."""
        half = COVERAGE * self.std_mm
        return (self.first_mm - half, self.first_mm + half), (self.last_mm - half, self.last_mm + half)


def stretches_of(
    profile: Profile, *, common_std_mm: float, correlation: float = 1.0, most: int | None = None
) -> tuple[Stretch, ...]:
    """The stretches that explain a profile best: fewest numbers for what they leave, by dynamic programming.

    Each stretch is a constant (two numbers, its end among them) or a straight line (three). What it leaves is counted in
    the sections' standard deviations, no smaller than they scatter from one to the next and a part of `LEAST_SHARE`.

    Args:
        profile: The diameter along the axis.
        common_std_mm: Standard uncertainty that all sections share, as of the scanner; grows with the diameter.
        correlation: By how much correlated residuals widen the standard deviations.
        most: 1 for one constant stretch, whatever it leaves.
    """
    s, d = profile.s_mm, profile.diameter_mm
    if len(s) < LEAST_SECTIONS:
        return ()
    scatter = robust_std(np.diff(d)) / np.sqrt(2)
    std = np.hypot(np.hypot(correlation * profile.std_mm, scatter), 0.5 * LEAST_SHARE * np.median(d))
    cuts, tapering = ([0, len(s)], [False]) if most == 1 else _cuts(s, d, std)
    out = []
    # A stretch begins half-way between sections; the first and the last section are as long on either side.
    edge = np.concatenate([[1.5 * s[0] - 0.5 * s[1]], 0.5 * (s[1:] + s[:-1]), [1.5 * s[-1] - 0.5 * s[-2]]])
    edge[[0, -1]] = max(edge[0], s[0] - 0.5 * profile.step_mm), min(edge[-1], s[-1] + 0.5 * profile.step_mm)
    for low, high, taper in zip(cuts[:-1], cuts[1:], tapering, strict=True):
        part = slice(low, high)
        ends = (float(edge[low]), float(edge[high]))
        first, last, own = _line(s[part], d[part], std[part], ends, taper=taper)
        middle = 0.5 * (first + last) / float(np.median(d))
        kind, whole = "tapering" if taper else "constant", float(np.hypot(own, common_std_mm * middle))
        out.append(
            Stretch(kind=kind, from_mm=float(ends[0]), to_mm=float(ends[1]), first_mm=first, last_mm=last, std_mm=whole)
        )
    return tuple(out)


def _cuts(s: np.ndarray, d: np.ndarray, std: np.ndarray) -> tuple[list[int], list[bool]]:
    """First rows of the best stretches and the number of rows; whether each tapers."""
    m = len(s)
    each = PENALTY * np.log(m)
    constant, line = _left_over(s, d, 1 / std**2)
    cost = np.minimum(constant + 2 * each, line + 3 * each)
    rows = np.arange(m + 1)
    cost[rows[None, :] - rows[:, None] < min(LEAST_SECTIONS, m)] = np.inf
    best, came = np.full(m + 1, np.inf), np.zeros(m + 1, dtype=int)
    best[0] = 0.0
    for end in range(1, m + 1):
        total = best[:end] + cost[:end, end]
        came[end] = int(np.argmin(total))
        best[end] = total[came[end]]
    cuts = [m]
    while cuts[-1] > 0:
        cuts.append(int(came[cuts[-1]]))
    cuts = cuts[::-1]
    pairs = pairwise(cuts)
    return cuts, [bool(line[a, b] + each < constant[a, b]) for a, b in pairs]


def _left_over(
    s: np.ndarray, d: np.ndarray, weight: np.ndarray
) -> tuple[Float[np.ndarray, "b b"], Float[np.ndarray, "b b"]]:
    """Weighted squares that the mean and the line of rows `[from, to)` leave, for all pairs; 0 backwards."""
    x, y = s - s.mean(), d - d.mean()
    sums = np.stack([weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y])
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(sums, axis=1)], axis=1)
    n, sx, sy, xx, xy, yy = sums[:, None, :] - sums[:, :, None]
    n = np.where(n > 0, n, 1.0)  # backwards the sums are negative, and never asked for
    constant = np.maximum(yy - sy**2 / n, 0.0)
    spread = np.maximum(xx - sx**2 / n, 1e-9)
    line = np.maximum(constant - (xy - sx * sy / n) ** 2 / spread, 0.0)
    return constant, line


def _line(
    s: np.ndarray, d: np.ndarray, std: np.ndarray, ends: tuple[float, float], *, taper: bool
) -> tuple[float, float, float]:
    """Diameters at both ends and the larger standard deviation of the two."""
    middle = float(np.average(s, weights=std**-2))
    columns = np.stack([np.ones_like(s), s - middle] if taper else [np.ones_like(s)])
    covariance = np.linalg.inv((columns / std**2) @ columns.T)
    found = covariance @ (columns @ (d / std**2))
    at = np.array([[1.0, end - middle] if taper else [1.0] for end in ends])
    first, last = at @ found
    return float(first), float(last), float(np.sqrt(np.einsum("ei,ij,ej->e", at, covariance, at).max()))


def diameter_at(stretches: tuple[Stretch, ...], s_mm: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The stretches' diameter at places along the axis `[n]`; beyond the ends and in gaps that of the nearest end."""
    place = np.array([end for one in stretches for end in (one.from_mm, one.to_mm)])
    value = np.array([end for one in stretches for end in (one.first_mm, one.last_mm)])
    # Where one ends and the next begins at the same place the diameter jumps there.
    return np.interp(s_mm, np.maximum.accumulate(place), value)


def within(stretches: tuple[Stretch, ...], low: float, high: float) -> tuple[Stretch, ...]:
    """The parts of stretches between two places along the axis; none shorter than a tenth of that."""
    out = []
    for one in stretches:
        ends = np.clip([one.from_mm, one.to_mm], low, high)
        if ends[1] - ends[0] > 0.1 * (high - low):
            first, last = np.interp(ends, [one.from_mm, one.to_mm], [one.first_mm, one.last_mm])
            ends = [float(end) for end in ends]
            out.append(
                Stretch(
                    kind=one.kind,
                    from_mm=ends[0],
                    to_mm=ends[1],
                    first_mm=float(first),
                    last_mm=float(last),
                    std_mm=one.std_mm,
                )
            )
    return tuple(out)


def mean_of(stretches: tuple[Stretch, ...]) -> tuple[float, float]:
    """Mean diameter over the length, and the standard deviation along it; 0 where the diameter is one."""
    length = np.array([one.length_mm for one in stretches])
    ends = np.array([(one.first_mm, one.last_mm) for one in stretches])
    mean = float(length @ ends.mean(axis=1) / length.sum())
    # A line from a to b has the mean square (a^2 + a b + b^2) / 3.
    square = float(length @ ((ends**2).sum(axis=1) + ends.prod(axis=1)) / 3 / length.sum())
    return mean, 0.0 if form_of(stretches) == ONE else float(np.sqrt(max(square - mean**2, 0.0)))


def changes(stretches: tuple[Stretch, ...]) -> list[tuple[float, float, float]]:
    """Where along the axis, size and standard uncertainty of each step between stretches that exceeds its uncertainty.

    What all diameters share does not show in a difference; it is taken to be the least of their standard deviations.
    """
    common_std_mm = min((one.std_mm for one in stretches), default=0.0)
    out = []
    for before, after in pairwise(stretches):
        jump = after.first_mm - before.last_mm
        own = [max(one.std_mm**2 - common_std_mm**2, 0.0) for one in (before, after)]
        std = float(np.sqrt(sum(own)))
        blur = max(_blur(before), _blur(after))  # where a taper ends is known to half a section
        if abs(jump) > max(SURE * std, LEAST_SHARE * before.last_mm, blur):
            out.append((0.5 * (before.to_mm + after.from_mm), jump, std))
    return out


def _blur(one: Stretch) -> float:
    """By how much the diameter of a tapering stretch changes within half a section."""
    slope = abs(one.last_mm - one.first_mm) / max(one.length_mm, 1e-9)
    return slope * min(one.length_mm / (2 * LEAST_SECTIONS), one.first_mm / 8)


def form_of(stretches: tuple[Stretch, ...]) -> str:
    """The stretches in words: "one diameter", "tapers from 110 to 75 mm", or "not one diameter" with its range.

    Example:
        >>> form_of((Stretch("tapering", 0.0, 3000.0, 110.0, 75.0, 1.0),))
        'tapers from 110 to 75 mm'
        >>> form_of((Stretch("constant", 0.0, 30.0, 34.4, 34.4, 0.1), Stretch("constant", 30.0, 55.0, 37.0, 37.0, 0.1)))
        'not one diameter: 34.4 to 37 mm in 2 stretches'
    """
    if not stretches or (len(stretches) == 1 and stretches[0].kind == "constant"):
        return ONE
    ends = [end for one in stretches for end in (one.first_mm, one.last_mm)]
    rising = np.diff(ends)
    slack = LEAST_SHARE * float(np.median(ends))
    even = bool((rising > -slack).all() or (rising < slack).all())
    if even and not changes(stretches) and any(one.kind == "tapering" for one in stretches):
        return f"tapers from {ends[0]:.4g} to {ends[-1]:.4g} mm"
    return f"not one diameter: {min(ends):.4g} to {max(ends):.4g} mm in {len(stretches)} stretches"
