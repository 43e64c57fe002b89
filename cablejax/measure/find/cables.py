"""Which points of a scan are the cable: flat clutter out, cylinders sought, walked and compared."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.measure.find.cylinder import radial
from cablejax.measure.find.hypotheses import ROUGHNESSES, TOLERANCE, find_candidates, score, tolerance_of
from cablejax.measure.find.planes import Plane, find_planes
from cablejax.measure.find.surface import Surface, surface
from cablejax.measure.find.track import Walk, walk

MOST_WALKS = 16
ROUNDS = 3  # of taking out planes and thinning what is left less


class Find(NamedTuple):
    """What a scan holds.

    Attributes:
        walks: Long round things, the best first; those that share points differ in radius.
        planes: Flat regions taken out before.
        flat_share: The part of the points that lay on them.
        surface: The thinned cloud that the walks' rows refer to.
    """

    walks: list[Walk]
    planes: list[Plane]
    flat_share: float
    surface: Surface


def _without_planes(xyz: np.ndarray, target: int, rng: np.random.Generator) -> tuple[Surface, list[Plane], int]:
    """Thin; take planes out of the full cloud; thin the rest again, which leaves more of a small cable."""
    planes: list[Plane] = []
    kept = xyz
    for _ in range(ROUNDS):
        thinned = surface(kept, target=target)
        found, flat = find_planes(thinned, rng=rng)
        if not found:
            break
        planes += found
        near = np.any([plane.holds(kept) for plane in found], axis=0)
        if (~near).sum() < 50:
            return thinned.subset(~flat), planes, int((~near).sum())
        kept = kept[~near]
    else:
        thinned = surface(kept, target=target)
    return thinned, planes, len(kept)


def merit(thinned: Surface, way: Walk) -> float:
    """How much of a cable a walk is.

    The number of its points, times the square root of the arc they show, its slenderness up to 2, how few other points
    lie about it (squared), and how well they lie on it.
    """
    radius = way.radius_mm
    distance, outward, along = radial(way.start, thinned.xyz)
    near = (np.abs(along) < 2 * radius) & (distance < 1.6 * radius)
    on = near & (np.abs(distance - radius) < tolerance_of(thinned, radius))
    if not on.any():
        return 0.0
    gathered = float(np.linalg.norm(outward[on].mean(axis=0)))
    scatter = float(np.median(np.abs(distance[on] - radius))) / radius
    alone = float(on.sum() / near.sum())
    slender = min(way.length_mm / (2 * radius), 2.0)
    return len(way.rows) * slender * float(np.sqrt(max(0.0, 1 - gathered))) * alone**2 / (1 + (scatter / 0.05) ** 2)


def share(way: Walk, other: Walk) -> float:
    """The part of a walk's points that another one holds as well."""
    return float(np.isin(way.rows, other.rows).mean())


def same(way: Walk, other: Walk) -> bool:
    """Whether two walks are the same thing: common points and about the same radius."""
    return share(way, other) > 0.3 and _alike(way.radius_mm, other.radius_mm)


def _alike(radius: float, other: float) -> bool:
    return 1 / 1.5 < radius / other < 1.5


def find_cables(
    xyz: Float[np.ndarray, "n 3"], *, rng: np.random.Generator, target: int = 20_000, most: int = 4
) -> Find:
    """Search a scan for cables.

    Args:
        xyz: Points `[n, 3]`, mm, without NaN.
        rng: Source of the random samples.
        target: Number of points to thin to.
        most: How many walks to return at most.
    """
    thinned, planes, left = _without_planes(xyz, target, rng)
    walks: list[tuple[float, Walk]] = []
    for candidate in find_candidates(thinned, rng=rng):
        radius = candidate.cylinder.radius_mm
        _, rows = score(thinned, candidate.cylinder, tolerance_of(thinned, radius))
        # A short piece does not hide the cable it lies on; nor a cylinder of another radius the right one, on a smooth surface.
        smooth = ROUGHNESSES * thinned.roughness_mm < TOLERANCE * radius
        long = [way for _, way in walks if way.length_mm >= 4 * way.radius_mm]
        before = [way.rows for way in long if not smooth or _alike(way.radius_mm, radius)]
        if len(walks) >= MOST_WALKS or (before and np.isin(rows, np.concatenate(before)).mean() > 0.5):
            continue
        way = walk(thinned, candidate.cylinder)
        if way is not None and way.length_mm >= radius:
            walks.append((merit(thinned, way), way))
    chosen: list[Walk] = []
    for value, way in sorted(walks, key=lambda pair: -pair[0]):
        if len(chosen) < most and value > 0 and not any(same(way, better) for better in chosen):
            chosen.append(way)
    return Find(chosen, planes, 1 - left / len(xyz), thinned)
