"""From one piece of a cable to the whole: step along the axis, refit, and stop where the surface stops."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from cablejax.measure.find.cylinder import Cylinder, fit_cylinder, radial
from cablejax.measure.find.hypotheses import facing, tolerance_of
from cablejax.measure.find.surface import Surface

STEP = 1.0  # radii
WINDOW = 1.5  # radii to either side
MAX_STEPS = 4000
CLOSED = 0.75  # steps from a centre passed before, within which a loop is closed
LATELY = 3  # of the last centres are not looked at for that
GAP_STEPS = 4  # steps without points that a tie or a bracket may hide
RING_SHARE = 0.9  # of all points, that a ring shorter than its radius must hold
RING_GATHERED = 0.2  # length of the mean outward direction: 0.19 where 300 degrees are seen


class Track(NamedTuple):
    """A cable followed along its axis.

    Attributes:
        axis: Points along it `[m, 3]`, in order.
        start: The cylinder it began with.
        rows: The surface's rows on it.
        merit: How much of a cable it is (`find.cables.judged`).
        scatter_mm: Median distance of the points about the start from its surface.
        ring: Whether it is shorter than its radius and still all that the scan shows.
    """

    axis: Float[np.ndarray, "m 3"]
    start: Cylinder
    rows: np.ndarray
    merit: float = 0.0
    scatter_mm: float = 0.0
    ring: bool = False

    @property
    def radius_mm(self) -> float:
        """The radius it began with, near which it stayed."""
        return self.start.radius_mm

    @property
    def length_mm(self) -> float:
        """Length of the polyline through the axis points."""
        return float(np.linalg.norm(np.diff(self.axis, axis=0), axis=1).sum())


def _near(surface: Surface, tree: KDTree, cylinder: Cylinder) -> np.ndarray:
    """Rows on the cylinder within the window about its centre."""
    radius = cylinder.radius_mm
    reach = radius * np.hypot(WINDOW, 1.3) + tolerance_of(surface, radius)
    rows = np.asarray(tree.query_ball_point(cylinder.center, reach), dtype=int)
    if len(rows) == 0:
        return rows
    distance, outward, along = radial(cylinder, surface.xyz[rows])
    on = (np.abs(along) < WINDOW * radius) & (np.abs(distance - radius) < tolerance_of(surface, radius))
    return rows[on & facing(surface.subset(rows), cylinder, outward)]


def _reaches(surface: Surface, cylinder: Cylinder, rows: np.ndarray) -> bool:
    """Whether points lie on both sides of the centre: at a free end they lie on one side alone."""
    along = (surface.xyz[rows] - cylinder.center) @ cylinder.direction
    ahead = (along > 0).sum()
    return bool(min(ahead, len(rows) - ahead) >= max(2, 0.1 * len(rows)))


def _one_way(
    surface: Surface, tree: KDTree, start: Cylinder, enough: int, passed: Sequence[np.ndarray] = ()
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Centres and rows from a start onwards, in the direction of its axis, until nothing follows or a loop closes.

    Args:
        surface: The thinned scan.
        tree: Of its points.
        start: Where to begin.
        enough: Points that a step must hold.
        passed: Centres of the other way.
    """
    centers, members = [], []
    closed = CLOSED * STEP * start.radius_mm
    current, gap = start, 0
    for _ in range(MAX_STEPS):
        ahead = Cylinder(
            current.center + STEP * current.radius_mm * current.direction, current.direction, start.radius_mm
        )
        rows = _near(surface, tree, ahead)
        if len(rows) < enough or not _reaches(surface, ahead, rows):
            gap += 1
            if gap > GAP_STEPS:
                break
            current = ahead
            continue
        place = ahead.center
        fitted, _ = fit_cylinder(surface.xyz[rows], ahead, radius_weight=2.0 * len(rows))
        # The fit slides its centre to the middle of its points; bring it back abreast of where the step led.
        center = fitted.center + ((place - fitted.center) @ fitted.direction) * fitted.direction
        turned = fitted.direction @ current.direction
        own = [start.center, *centers]
        before = np.array([*passed, *own[:-LATELY]]).reshape(-1, 3)
        if (np.linalg.norm(before - center, axis=1) < closed).any():
            break
        if turned < np.cos(np.radians(40)) or np.linalg.norm(center - place) > 0.5 * start.radius_mm:
            break
        gap = 0
        current = Cylinder(center, fitted.direction, start.radius_mm)
        centers.append(center)
        members.append(rows)
    return centers, members


def follow(surface: Surface, start: Cylinder) -> Track | None:
    """Follow a cable both ways from one of its pieces; None where not even the start holds six points.

    The radius stays close to the start's, so the track does not drift onto a wall; the axis is free to bend.
    """
    tree = KDTree(surface.xyz)
    rows = _near(surface, tree, start)
    if len(rows) < 6:
        return None
    enough = max(5, len(rows) // 6)
    back = Cylinder(start.center, -start.direction, start.radius_mm)
    ahead, ahead_rows = _one_way(surface, tree, start, enough)
    behind, behind_rows = _one_way(surface, tree, back, enough, ahead)
    centers = np.array([*behind[::-1], start.center, *ahead])
    members = [*behind_rows[::-1], rows, *ahead_rows]
    first = _end(surface, centers[0], centers[min(1, len(centers) - 1)], start, members[0], -1.0)
    last = _end(surface, centers[-1], centers[max(-2, -len(centers))], start, members[-1], 1.0)
    axis = np.array([*([] if first is None else [first]), *centers, *([] if last is None else [last])])
    return Track(axis, start, np.unique(np.concatenate(members)))


def ring(surface: Surface, cylinder: Cylinder) -> Track | None:
    """The track of a ring, too short to be followed, that is all the scan shows and is seen all round; None if it is not.

    A cable that lies in a circle is none: its normals point away from the circle's axis on its outermost side alone.
    """
    distance, outward, along = radial(cylinder, surface.xyz)
    on = np.abs(distance - cylinder.radius_mm) < tolerance_of(surface, cylinder.radius_mm)
    rows = np.flatnonzero(on & facing(surface, cylinder, outward))
    if len(rows) < RING_SHARE * len(surface.xyz) or np.linalg.norm(outward[rows].mean(axis=0)) > RING_GATHERED:
        return None
    ends = np.array([along[rows].min(), along[rows].max()])
    return Track(cylinder.center + ends[:, None] * cylinder.direction, cylinder, rows, ring=True)


def _end(
    surface: Surface, center: np.ndarray, before: np.ndarray, start: Cylinder, rows: np.ndarray, sign: float
) -> np.ndarray | None:
    """How far the points of the last window reach beyond its centre; None if not by a tenth of the radius."""
    step = center - before
    length = np.linalg.norm(step)
    direction = step / length if length > 0 else sign * start.direction
    reach = float(np.quantile((surface.xyz[rows] - center) @ direction, 0.98))
    return center + reach * direction if reach > 0.1 * start.radius_mm else None
