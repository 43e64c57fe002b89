"""Floors, walls and tables: planes found by random samples, told apart from strips of a cable."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, KDTree

from cablejax.geometry.normals import covariances, fitted_planes
from cablejax.geometry.principal import principal_axes
from cablejax.geometry.robust import robust_std
from cablejax.measure.find.surface import Surface

MAX_PLANES = 8
MIN_SHARE = 0.04  # of the points, for a plane to be worth taking out
NORMAL_COS = np.cos(np.radians(20))
FLAT_TILT = 0.08  # rad at the rim: a wider turn of the surface is a curved one
LOCAL = 24  # points of a small neighbourhood
ROUGHER = (
    6.0  # times the scatter of small neighbourhoods: floors and boxes under depth cameras reach 4.3, a full tray 12
)
TURNED_COS = float(
    np.cos(np.radians(15))
)  # half of their normals turned by more: floors reach 12 degrees, a full tray 24
MIN_FILL = 0.4  # of the outline: the crest of a bent cable fills little of its own
MIN_WIDTH = 8.0  # least standard deviation across, in tolerances: a strip of a cable is narrower


class Plane(NamedTuple):
    """A flat region.

    Attributes:
        center: Mean of its points `[3]`, mm.
        normal: Unit normal `[3]`.
        across_mm, along_mm: Standard deviations of its points in the plane.
        tolerance_mm: Distance from the plane within which a point counts as on it.
    """

    center: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    across_mm: float
    along_mm: float
    tolerance_mm: float

    def holds(self, xyz: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points lie on it: near the plane, and not far outside its outline."""
        offset = xyz - self.center
        height = offset @ self.normal
        side = np.linalg.norm(offset - height[:, None] * self.normal, axis=1)
        return (np.abs(height) < self.tolerance_mm) & (side < 3 * self.along_mm)


def _members(surface: Surface, center: np.ndarray, normal: np.ndarray, tolerance: float) -> np.ndarray:
    near = np.abs((surface.xyz - center) @ normal) < tolerance
    return near & (np.abs(surface.normals @ normal) > NORMAL_COS)


def _best_plane(surface: Surface, tolerance: float, rng: np.random.Generator) -> np.ndarray:
    """Members `[m]` of the best of 200 planes, each through one point and its normal, then fitted twice."""
    rows = rng.choice(len(surface.xyz), size=min(200, len(surface.xyz)), replace=False)
    sample = surface.subset(rng.choice(len(surface.xyz), size=min(3000, len(surface.xyz)), replace=False))
    offset = np.einsum("ij,ij->i", surface.xyz[rows], surface.normals[rows])
    near = np.abs(sample.xyz @ surface.normals[rows].T - offset[None, :]) < tolerance
    aligned = np.abs(sample.normals @ surface.normals[rows].T) > NORMAL_COS
    best = rows[np.argmax((near & aligned).sum(axis=0))]
    members = _members(surface, surface.xyz[best], surface.normals[best], tolerance)
    for _ in range(3):
        if members.sum() < 3:
            break
        center, axes, _ = principal_axes(surface.xyz[members])
        members = _members(surface, center, axes[2], tolerance)
    return members


def _describe(surface: Surface, members: np.ndarray, tolerance: float) -> tuple[Plane, float, float]:
    """The plane of its members, the turn of their normals from the centre to the rim in rad, and `_fill`."""
    xyz = surface.xyz[members]
    center, axes, spread = principal_axes(xyz)
    normals = surface.normals[members]
    normals = normals * np.sign(normals @ axes[2])[:, None]
    place = (xyz - center) @ axes[:2].T
    turn, *_ = np.linalg.lstsq(place, (normals - normals.mean(axis=0)) @ axes[:2].T, rcond=None)
    tilt = float(np.abs(turn * 1.7 * spread[:2, None]).max())  # the rim of an even strip is at 1.7 deviations
    plane = Plane(center, axes[2], float(spread[1]), float(spread[0]), tolerance)
    return plane, tilt, _fill(surface, members, plane, axes[:2])


def _fill(surface: Surface, members: np.ndarray, plane: Plane, axes: np.ndarray) -> float:
    """Which share of its convex outline a plane's points cover."""
    place = (surface.xyz[members] - plane.center) @ axes.T
    cell = 3 * max(surface.spacing_mm, surface.reach_mm / len(surface.xyz))  # repeated points are no distance apart
    covered = len(np.unique(np.floor(place / cell).astype(int), axis=0)) * cell**2
    return covered / max(ConvexHull(place).volume, 1e-12)  # "volume" of a flat hull is its area


def find_planes(surface: Surface, *, rng: np.random.Generator) -> tuple[list[Plane], Bool[np.ndarray, " m"]]:
    """Flat regions of a surface.

    A strip of a cable lies near a plane as well. It is told apart by its normals, which turn from rim to rim, and by its
    width, which does not exceed a few times the tolerance.

    Returns:
        The planes, largest first as a rule, and which points `[m]` lie on one.
    """
    tolerance = 3 * surface.roughness_mm + 0.05 * surface.spacing_mm
    free = np.ones(len(surface.xyz), dtype=bool)
    planes = []
    for _ in range(MAX_PLANES):
        rows = np.flatnonzero(free)
        if len(rows) < 50:
            break
        members = _best_plane(surface.subset(rows), tolerance, rng)
        if members.sum() < max(30, MIN_SHARE * len(surface.xyz)):
            break
        plane, tilt, fill = _describe(surface.subset(rows), members, tolerance)
        if tilt > FLAT_TILT or fill < MIN_FILL or plane.across_mm < MIN_WIDTH * tolerance:
            break
        planes.append(plane)
        free[rows[members]] = False
    return planes, ~free


def corrugated(plane: Plane, xyz: Float[np.ndarray, "n 3"]) -> bool:
    """Whether a region that is flat in the thinned scan is a row of cables in the whole one.

    Thinned so far that a neighbourhood is as wide as a cable, the crests of a full tray make a plane. In the scan itself
    the normals turn, and the heights vary by far more than small neighbourhoods scatter about their own planes.

    Args:
        plane: The region.
        xyz: The scan's own points `[n, 3]`.
    """
    on = xyz[plane.holds(xyz)]
    if len(on) < 2 * LOCAL:
        return False
    height = (on - plane.center) @ plane.normal
    spread = robust_std(height - np.median(height))
    sample = on[np.random.default_rng(0).choice(len(on), size=min(300, len(on)), replace=False)]
    near = np.asarray(KDTree(on).query(sample, k=LOCAL, workers=-1)[1])
    normals, scatter = fitted_planes(covariances(on, near, at=sample))
    turned = float(np.median(np.abs(normals @ plane.normal)))
    return spread > ROUGHER * float(np.median(scatter)) and turned < TURNED_COS
