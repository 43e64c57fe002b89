"""Where a cable might be: cylinders through pairs of oriented points, scored on their own surroundings."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from cablejax.geometry.principal import principal_axes
from cablejax.measure.find.cylinder import Cylinder, fit_cylinder, radial
from cablejax.measure.find.surface import Surface
from cablejax.measure.settings import SearchLimits

NORMAL_COS = np.cos(np.radians(30))
TOLERANCE, ROUGHNESSES = (
    0.1,
    3.0,
)  # a point lies on a cylinder within so much of the radius, or so many times the roughness
SAMPLE = 1_500  # points on which all hypotheses are scored
AT_ONCE = 32  # hypotheses scored at once: their distances to the sample stay in the cache
LEAST_POINTS = 6  # on a cylinder that counts
ROUGH_RADIUS = 1.2  # times the limits of the diameter, within which a local cylinder is looked at
AXIS_DEG = 20.0
AXIS_COS = float(np.cos(np.radians(AXIS_DEG)))
REACH = 3.0  # radii: a cable that bends by 15 diameters leaves its tangent by 0.15 radii over that length


class Candidate(NamedTuple):
    """A local cylinder and its score: the points on it, less those inside it, weighted by the arc they cover."""

    cylinder: Cylinder
    score: float


def _pairs(surface: Surface, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows of first points and of second points near them, the distance drawn evenly on a log scale."""
    tree = KDTree(surface.xyz)
    reach = min(256, len(surface.xyz))
    first = rng.integers(len(surface.xyz), size=count)
    _, near = tree.query(surface.xyz[first], k=reach, workers=-1)
    rank = np.exp(rng.uniform(np.log(min(8, reach - 1)), np.log(reach), size=count)).astype(int)
    near = np.asarray(near)
    return first, near[np.arange(count), np.minimum(rank, reach - 1)]


def _hypotheses(surface: Surface, first: Int[np.ndarray, " h"], second: Int[np.ndarray, " h"], largest: float):
    """Cylinders through pairs of points with normals: centre, direction, radius; bad pairs dropped."""
    p, q, n, m = surface.xyz[first], surface.xyz[second], surface.normals[first], surface.normals[second]
    direction = np.cross(n, m)
    sine = np.linalg.norm(direction, axis=1)
    keep = sine > 0.15
    p, q, n, m, direction, sine = (a[keep] for a in (p, q, n, m, direction, sine))
    direction = direction / sine[:, None]
    # In the plane square to the axis both normals meet at the centre: p + a n = q + b m.
    across = q - p - np.einsum("hi,hi->h", q - p, direction)[:, None] * direction
    cos = np.einsum("hi,hi->h", n, m)
    dot_n, dot_m = np.einsum("hi,hi->h", across, n), np.einsum("hi,hi->h", across, m)
    a = (dot_n - cos * dot_m) / sine**2
    b = (cos * dot_n - dot_m) / sine**2
    radius = (np.abs(a) + np.abs(b)) / 2
    good = (np.abs(np.abs(a) - np.abs(b)) < 0.3 * radius) & (radius < largest) & (radius > surface.spacing_mm)
    center = p + np.sign(a)[:, None] * radius[:, None] * n
    return center[good], direction[good], radius[good]


def facing(surface: Surface, cylinder: Cylinder, outward: np.ndarray) -> np.ndarray:
    """Which normals point away from the axis; all, where the cylinder is thinner than what the normals come from."""
    if cylinder.radius_mm < surface.reach_mm:
        return np.ones(len(outward), dtype=bool)
    return np.abs(np.einsum("ij,ij->i", outward, surface.normals)) > NORMAL_COS


def score(surface: Surface, cylinder: Cylinder, tolerance: float) -> tuple[float, np.ndarray]:
    """Score of a cylinder within `REACH` radii of its centre, and the rows of its points."""
    distance, outward, along = radial(cylinder, surface.xyz)
    here = (np.abs(along) < REACH * cylinder.radius_mm) & (distance < 1.5 * cylinder.radius_mm + tolerance)
    residual = np.abs(distance - cylinder.radius_mm)
    on = here & (residual < tolerance) & facing(surface, cylinder, outward)
    inside = here & (distance < cylinder.radius_mm - 2 * tolerance)
    rows = np.flatnonzero(on)
    if len(rows) < LEAST_POINTS:
        return 0.0, rows
    gathered = np.linalg.norm(outward[rows].mean(axis=0))  # 1 for a sliver of arc, 0.64 for a half, 0 for the whole
    fit = float(np.sum(1 - (residual[rows] / tolerance) ** 2))
    return (fit - float(inside.sum())) * float(np.sqrt(max(0.0, 1 - gathered))), rows


def rough_scores(sample: Surface, guesses: Sequence[Cylinder]) -> Float[np.ndarray, " h"]:
    """The scores of many cylinders `[h]`, as `score` gives them but for rounding, in a fifth of its time."""
    if not guesses:
        return np.zeros(0)
    center, direction = (np.stack([each[i] for each in guesses]) for i in (0, 1))
    radius = np.array([guess.radius_mm for guess in guesses])
    tolerance = np.array([tolerance_of(sample, each) for each in radius])
    pieces = range(0, len(guesses), AT_ONCE)
    return np.concatenate(
        [
            _rough(sample, *(a[first : first + AT_ONCE] for a in (center, direction, radius, tolerance)))
            for first in pieces
        ]
    )


def _rough(
    sample: Surface,
    center: Float[np.ndarray, "h 3"],
    direction: Float[np.ndarray, "h 3"],
    radius: Float[np.ndarray, " h"],
    tolerance: Float[np.ndarray, " h"],
) -> Float[np.ndarray, " h"]:
    """`rough_scores` for as many as fit the cache, by products of matrices `[h, m]`."""
    xyz, normals = sample.xyz, sample.normals
    along = direction @ xyz.T - np.einsum("hi,hi->h", center, direction)[:, None]
    square = np.einsum("mi,mi->m", xyz, xyz) - 2 * center @ xyz.T + np.einsum("hi,hi->h", center, center)[:, None]
    distance = np.sqrt(np.maximum(square - along**2, 1e-24))
    size, room = radius[:, None], tolerance[:, None]
    here = (np.abs(along) < REACH * size) & (distance < 1.5 * size + room)
    residual = np.abs(distance - size)
    # The outward direction times the normal, times the distance.
    outward = np.einsum("mi,mi->m", xyz, normals) - center @ normals.T - along * (direction @ normals.T)
    faces = (np.abs(outward) > NORMAL_COS * distance) | (size < sample.reach_mm)
    on = here & (residual < room) & faces
    inside = np.count_nonzero(here & (distance < size - 2 * room), axis=1)
    count = np.count_nonzero(on, axis=1)
    share = np.where(on, 1 / distance, 0.0)
    total = share @ xyz - share.sum(axis=1)[:, None] * center - (share * along).sum(axis=1)[:, None] * direction
    gathered = np.linalg.norm(total, axis=1) / np.maximum(count, 1)
    fit = np.where(on, 1 - (residual / room) ** 2, 0.0).sum(axis=1)
    return np.where(count < LEAST_POINTS, 0.0, (fit - inside) * np.sqrt(np.maximum(0.0, 1 - gathered)))


def tolerance_of(surface: Surface, radius: float) -> float:
    """How far a point may lie from its cylinder: three times the roughness, between a tenth and half of the radius."""
    return float(np.clip(ROUGHNESSES * surface.roughness_mm, TOLERANCE * radius, 0.5 * radius))


def _threads(surface: Surface, count: int, rng: np.random.Generator) -> list[Cylinder]:
    """Cylinders along neighbourhoods that are much longer than wide, for things too thin to have normals."""
    tree = KDTree(surface.xyz)
    found = []
    for k in (32, 96, 288):
        if k > len(surface.xyz):
            break
        _, near = tree.query(surface.xyz[rng.integers(len(surface.xyz), size=count)], k=k, workers=-1)
        for rows in np.asarray(near):
            xyz = surface.xyz[rows]
            center, axes, std = principal_axes(xyz)
            if std[0] < 2.5 * std[1]:
                continue
            place = (xyz - center) @ axes[1:].T
            system = np.concatenate([2 * place, np.ones((k, 1))], axis=1)
            circle, *_ = np.linalg.lstsq(system, np.sum(place**2, axis=1), rcond=None)  # Kasa's circle: a start
            radius = float(np.sqrt(max(circle[2] + circle[0] ** 2 + circle[1] ** 2, 0.0)))
            found.append(Cylinder(center + circle[:2] @ axes[1:], axes[0], radius))
    return found


def _guesses(surface: Surface, rng: np.random.Generator, tries: int) -> list[Cylinder]:
    """Cylinders from pairs of normals, and along threads."""
    largest = 0.5 * float(np.linalg.norm(np.ptp(surface.xyz, axis=0)))
    first, second = _pairs(surface, tries, rng)
    rows = zip(*_hypotheses(surface, first, second, largest), strict=True)
    pairs = [Cylinder(center, direction, float(radius)) for center, direction, radius in rows]
    return pairs + _threads(surface, 60, rng)


def _refine(surface: Surface, cylinder: Cylinder) -> Candidate:
    """Fit a hypothesis to its own points, twice, and score it on all of them."""
    for _ in range(2):
        _, rows = score(surface, cylinder, tolerance_of(surface, cylinder.radius_mm))
        if len(rows) < 12:
            return Candidate(cylinder, 0.0)
        cylinder, _ = fit_cylinder(surface.xyz[rows], cylinder)
    return Candidate(cylinder, score(surface, cylinder, tolerance_of(surface, cylinder.radius_mm))[0])


def _within(cylinders: list[Cylinder], surface: Surface, limits: SearchLimits) -> list[Cylinder]:
    """Those wider than the spacing, no wider than the scan, and within the limits."""
    largest = 0.5 * float(np.linalg.norm(np.ptp(surface.xyz, axis=0)))
    low, high = (0.0, np.inf) if limits.diameter_mm is None else limits.diameter_mm
    # A hypothesis through two points is rough: its fit decides.
    low, high = max(surface.spacing_mm, 0.5 * low / ROUGH_RADIUS), min(largest, 0.5 * high * ROUGH_RADIUS)
    return [one for one in cylinders if low < one.radius_mm < high and _along(one, limits)]


def _along(cylinder: Cylinder, limits: SearchLimits) -> bool:
    if limits.axis is None:
        return True
    wanted = np.array(limits.axis) / np.linalg.norm(limits.axis)
    return bool(abs(cylinder.direction @ wanted) > AXIS_COS)


def _apart(cylinders: list[Cylinder], most: int) -> list[Cylinder]:
    """The first `most` of a list that are not one another's continuation: other axes, or other places along them."""
    kept: list[Cylinder] = []
    for one in cylinders:
        if len(kept) == most:
            break
        for other in kept:
            offset = one.center - other.center
            along = float(offset @ other.direction)
            aside = float(np.linalg.norm(offset - along * other.direction))
            turned = abs(float(one.direction @ other.direction))
            if aside < 0.5 * other.radius_mm and abs(along) < 2 * REACH * other.radius_mm and turned > 0.9:
                break
        else:
            kept.append(one)
    return kept


def find_candidates(
    surface: Surface,
    *,
    rng: np.random.Generator,
    tries: int = 3000,
    per_octave: int = 4,
    limits: SearchLimits | None = None,
    apart: bool = False,
) -> list[Candidate]:
    """The best local cylinders of a surface, best first, each fitted to its own points.

    Pairs of points with normals give cylinders; all are scored on a sample. A large surface always holds more points
    than a thin cable beside it, so the best `per_octave` of each doubling of the radius are kept and compared later.

    Args:
        surface: The thinned scan.
        rng: Source of the random samples.
        tries: Number of pairs.
        per_octave: How many of each doubling of the radius are fitted.
        limits: Diameters and directions that are sought; any if None.
        apart: Whether those kept must lie apart: for scenes of many cables, of which the best would else come many times.
    """
    limits = SearchLimits() if limits is None else limits
    if len(surface.xyz) < 20:
        return []
    guesses = _within(_guesses(surface, rng, tries), surface, limits)
    if not guesses:
        return []
    some = SAMPLE if not apart else 3 * SAMPLE
    sample = surface.subset(rng.choice(len(surface.xyz), size=min(some, len(surface.xyz)), replace=False))
    rough = rough_scores(sample, guesses)
    octave = np.floor(np.log2([guess.radius_mm for guess in guesses])).astype(int)
    found = []
    for level in np.unique(octave):
        rows = np.flatnonzero(octave == level)
        best = [
            guesses[index] for index in rows[np.argsort(-rough[rows], kind="stable")] if rough[index] > 0 or not apart
        ]
        for guess in _apart(best, per_octave) if apart else best[:per_octave]:
            candidate = _refine(surface, guess)
            if candidate.score > 0 and _within([candidate.cylinder], surface, limits):
                found.append(candidate)
    return sorted(found, key=lambda candidate: -candidate.score)
