"""Which points of a scan are the cable: flat clutter out, cylinders sought, followed and compared."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.measure.find.cylinder import radial
from cablejax.measure.find.hypotheses import ROUGHNESSES, TOLERANCE, Candidate, find_candidates, score, tolerance_of
from cablejax.measure.find.planes import Plane, corrugated, find_planes
from cablejax.measure.find.surface import Surface, surface
from cablejax.measure.find.track import Track, follow, ring
from cablejax.measure.settings import SearchLimits

THINNER, NEARER = 0.8, 0.5  # of a track's radius and scatter, below which another explains its points better
ROUNDS = 3  # of taking out planes and thinning what is left less


class Find(NamedTuple):
    """What a scan holds.

    Attributes:
        tracks: Long round things, the best first; those that share points differ in radius.
        planes: Flat regions taken out before.
        flat_share: The part of the points that lay on them.
        surface: The thinned cloud that the tracks' rows refer to.
        limits: What was sought.
    """

    tracks: list[Track]
    planes: list[Plane]
    flat_share: float
    surface: Surface
    limits: SearchLimits = SearchLimits()


class _Effort(NamedTuple):
    """How hard cables are sought: points to thin to, neighbours of a normal, pairs of points, cylinders kept of each octave,
    tracks followed, and tracks returned."""

    target: int
    neighbors: int
    tries: int
    per_octave: int
    followed: int
    most: int


BEST = _Effort(20_000, 24, 3_000, 4, 16, 4)
EVERY = _Effort(60_000, 16, 6_000, 40, 80, 60)


def _without_planes(xyz: np.ndarray, effort: _Effort, rng: np.random.Generator) -> tuple[Surface, list[Plane], int]:
    """Thin; take planes out of the full cloud; thin the rest again, which leaves more of a small cable."""
    planes: list[Plane] = []
    kept = xyz
    for _ in range(ROUNDS):
        thinned = surface(kept, target=effort.target, k=effort.neighbors)
        found, flat = find_planes(thinned, rng=rng)
        found = [plane for plane in found if not corrugated(plane, kept)]
        if not found:
            break
        planes += found
        near = np.any([plane.holds(kept) for plane in found], axis=0)
        if (~near).sum() < 50:
            return thinned.subset(~flat), planes, int((~near).sum())
        kept = kept[~near]
    else:
        thinned = surface(kept, target=effort.target, k=effort.neighbors)
    return thinned, planes, len(kept)


def judged(thinned: Surface, track: Track) -> Track:
    """A track with its scatter, and how much of a cable it is.

    The number of its points, times the square root of the arc they show, its slenderness up to 2, how few other points
    lie about it (squared), and how well they lie on it. A ring that holds the whole scan is not less for being short.
    """
    radius = track.radius_mm
    distance, outward, along = radial(track.start, thinned.xyz)
    near = (np.abs(along) < 2 * radius) & (distance < 1.6 * radius)
    on = near & (np.abs(distance - radius) < tolerance_of(thinned, radius))
    if not on.any():
        return track
    gathered = float(np.linalg.norm(outward[on].mean(axis=0)))
    scatter = float(np.median(np.abs(distance[on] - radius)))
    alone = float(on.sum() / near.sum())
    slender = 2.0 if track.ring else min(track.length_mm / (2 * radius), 2.0)
    merit = len(track.rows) * slender * float(np.sqrt(max(0.0, 1 - gathered))) * alone**2
    return track._replace(merit=merit / (1 + (scatter / radius / 0.05) ** 2), scatter_mm=scatter)


def share(track: Track, other: Track) -> float:
    """The part of a track's points that another one holds as well."""
    return float(np.isin(track.rows, other.rows).mean())


def several(track: Track, others: list[Track]) -> bool:
    """Whether most of a track's points lie on thinner ones, each much nearer its own: a row of cables, seen from afar."""
    thinner = [
        other.rows
        for other in others
        if other.radius_mm < THINNER * track.radius_mm and other.scatter_mm < NEARER * track.scatter_mm
    ]
    return bool(thinner) and bool(np.isin(track.rows, np.concatenate(thinner)).mean() > 0.5)


def same(track: Track, other: Track) -> bool:
    """Whether two tracks are the same thing: common points and about the same radius."""
    return share(track, other) > 0.3 and alike(track.radius_mm, other.radius_mm)


def alike(radius: float, other: float) -> bool:
    """Whether two radii may be of the same thing."""
    return 1 / 1.5 < radius / other < 1.5


def find_cables(
    xyz: Float[np.ndarray, "n 3"],
    *,
    rng: np.random.Generator,
    every: bool = False,
    limits: SearchLimits | None = None,
) -> Find:
    """Search a scan for cables.

    Args:
        xyz: Points `[n, 3]`, mm, without NaN.
        rng: Source of the random samples.
        every: Whether all are sought, rather than the best few.
        limits: What is known of them, `near_mm` in the coordinates of the points.

    Returns:
        The tracks, best first; those nearest to `limits.near_mm` first where it is given.
    """
    limits = SearchLimits() if limits is None else limits
    effort = EVERY if every else BEST
    thinned, planes, left = _without_planes(xyz, effort, rng)
    candidates = find_candidates(
        thinned, rng=rng, tries=effort.tries, per_octave=effort.per_octave, limits=limits, apart=every
    )
    tracks = _tracks(thinned, candidates, effort.followed)
    chosen: list[Track] = []
    for track in sorted(tracks, key=lambda track: -track.merit):
        if len(chosen) < effort.most and track.merit > 0 and not any(same(track, better) for better in chosen):
            chosen.append(track)
    if limits.near_mm is not None:
        chosen.sort(key=lambda track: _distance(track, np.array(limits.near_mm)))
    return Find(chosen, planes, 1 - left / len(xyz), thinned, limits)


def _tracks(thinned: Surface, candidates: list[Candidate], most: int) -> list[Track]:
    """Candidates followed both ways, each with its merit; no more than `most`."""
    tracks: list[Track] = []
    for candidate in candidates:
        radius = candidate.cylinder.radius_mm
        _, rows = score(thinned, candidate.cylinder, tolerance_of(thinned, radius))
        # A short piece does not hide the cable it lies on; nor a cylinder of another radius the right one, on a smooth surface.
        smooth = ROUGHNESSES * thinned.roughness_mm < TOLERANCE * radius
        long = [track for track in tracks if track.length_mm >= 4 * track.radius_mm]
        before = [track.rows for track in long if not smooth or alike(track.radius_mm, radius)]
        if len(tracks) >= most or (before and np.isin(rows, np.concatenate(before)).mean() > 0.5):
            continue
        track = follow(thinned, candidate.cylinder)
        if track is not None and track.length_mm < radius:
            track = ring(thinned, candidate.cylinder)
        if track is not None:
            tracks.append(judged(thinned, track))
    return tracks


def _distance(track: Track, point: np.ndarray) -> float:
    """From a point to the track's polyline."""
    first, step = track.axis[:-1], np.diff(track.axis, axis=0)
    share = np.clip(np.sum((point - first) * step, axis=1) / np.maximum(np.sum(step**2, axis=1), 1e-12), 0, 1)
    return float(np.linalg.norm(first + share[:, None] * step - point, axis=1).min())
