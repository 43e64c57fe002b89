"""Sizes of a section in the words of ISO 14405-1: the circles associated with a closed profile, and sizes across it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MOST_STEPS = 50
SETTLED = 1e-10  # of the radius, by which a centre still moves


class SectionSizes(NamedTuple):
    """Sizes of one profile, mm.

    Attributes:
        least_squares_mm: Diameter of the Gaussian (least-squares) circle, modifier GG.
        minimum_zone_mm: Of the minimax (Chebyshev) circle, midway between the two concentric ones that lie closest
            together and enclose the profile, GC.
        maximum_inscribed_mm: Of the largest circle within, GX.
        minimum_circumscribed_mm: Of the smallest circle around, GN.
        roundness_mm: Radial distance of the two circles of the minimum zone: the deviation from roundness (ISO 1101).
        two_point_minimum_mm, two_point_maximum_mm: Least and greatest two-point size, through the centre of the
            least-squares circle, LP with SN and SX.
    """

    least_squares_mm: float
    minimum_zone_mm: float
    maximum_inscribed_mm: float
    minimum_circumscribed_mm: float
    roundness_mm: float
    two_point_minimum_mm: float
    two_point_maximum_mm: float


def section_sizes(angle_deg: Float[np.ndarray, " a"], radius_mm: Float[np.ndarray, " a"]) -> SectionSizes:
    """Associate circles with a closed profile given by its distance from a point inside.

    The circles are those of the points given, which should be a smooth profile: of noisy points, the inscribed circle is
    too small and the circumscribed one too large.

    Args:
        angle_deg: Directions `[a]`, evenly spaced over the whole turn, an even number.
        radius_mm: Distance in each `[a]`.

    Raises:
        ValueError: If the directions are not evenly spaced over a turn, or a distance is not positive.

    Example:
        >>> angle = np.arange(180) * 2.0
        >>> sizes = section_sizes(angle, 15 + 0.2 * np.cos(3 * np.radians(angle)))
        >>> [round(size, 3) for size in (sizes.minimum_zone_mm, sizes.maximum_inscribed_mm, sizes.roundness_mm)]
        [30.0, 29.6, 0.4]
    """
    angle, radius = np.asarray(angle_deg, dtype=float), np.asarray(radius_mm, dtype=float)
    n = len(angle)
    even = n >= 6 and n % 2 == 0 and np.allclose(np.diff(angle), 360 / n)
    if angle.shape != radius.shape or not even:
        raise ValueError(f"angle_deg: expected an even number of even steps over a turn, got {n} from {angle[:3]}")
    if not (np.isfinite(radius) & (radius > 0)).all():
        raise ValueError(f"radius_mm: expected positive numbers, got a least of {radius.min()}")
    turn = np.radians(angle)
    points = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    centre, gaussian = _least_squares(points)
    low, high = _extreme(points, centre)
    _, around = _extreme(points, centre, inner=0.0)
    inside, _ = _extreme(points, centre, outer=0.0)
    across = _about(points, centre, turn)
    across = across + np.roll(across, n // 2)
    return SectionSizes(
        least_squares_mm=2 * gaussian,
        minimum_zone_mm=low + high,
        maximum_inscribed_mm=2 * inside,
        minimum_circumscribed_mm=2 * around,
        roundness_mm=high - low,
        two_point_minimum_mm=float(across.min()),
        two_point_maximum_mm=float(across.max()),
    )


def _least_squares(points: Float[np.ndarray, "a 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre and radius of least squared radial distances, by Gauss-Newton."""
    centre, radius = points.mean(axis=0), 0.0
    for _ in range(MOST_STEPS):
        distance = np.linalg.norm(points - centre, axis=1)
        columns = np.column_stack([np.ones(len(points)), (points - centre) / distance[:, None]])
        radius, *step = np.linalg.lstsq(columns, distance, rcond=None)[0]
        centre = centre + step
        if np.linalg.norm(step) < SETTLED * radius:
            break
    return centre, float(radius)


def _extreme(
    points: Float[np.ndarray, "a 2"], centre: Float[np.ndarray, "2"], *, inner: float = 1.0, outer: float = 1.0
) -> tuple[float, float]:
    """Radii of two concentric circles with the profile between them that make `outer` high - `inner` low least.

    Linear programs in the centre and the radii, each about the centre of the last.
    """
    from scipy.optimize import linprog  # half a second, for cables seen all round alone

    low = high = 0.0
    for _ in range(MOST_STEPS):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        along = offset / distance[:, None]
        ones, zeros = np.ones(len(points)), np.zeros(len(points))
        # distance - along . step is between low and high; unknowns: step, low, high.
        above = np.column_stack([-along, zeros, -ones])
        below = np.column_stack([along, ones, zeros])
        found = linprog(
            [0.0, 0.0, -inner, outer], A_ub=np.concatenate([above, below]),
            b_ub=np.concatenate([-distance, distance]), bounds=_bounds(distance),
        )  # fmt: skip
        step = found.x[:2]
        centre = centre + step
        distance = np.linalg.norm(points - centre, axis=1)
        low, high = float(distance.min()), float(distance.max())
        if np.linalg.norm(step) < SETTLED * high:
            break
    return low, high


def _bounds(distance: np.ndarray) -> list[tuple[float, float]]:
    """A step may not leave the profile, and neither radius may leave its distances by more than such a step."""
    most = float(distance.max())
    return [(-0.1 * most, 0.1 * most)] * 2 + [(0.0, 2 * most)] * 2


def _about(points: Float[np.ndarray, "a 2"], centre: np.ndarray, turn: np.ndarray) -> Float[np.ndarray, " a"]:
    """Distances of the profile from another centre, in the same directions; linear in the angle between its points."""
    offset = points - centre
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(angle)
    return np.interp(turn, angle[order], np.linalg.norm(offset, axis=1)[order], period=2 * np.pi)
