"""One point per voxel, normals and local noise: what the search for a cable looks at."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from cablejax.geometry.normals import covariances, fitted_planes
from cablejax.geometry.voxels import voxel_groups

LEAST_NEIGHBORS, PER_NEIGHBOR = 6, 8  # points for a normal at least, and of the whole cloud for each of them


class Surface(NamedTuple):
    """A thinned cloud with the plane through each point's neighbourhood.

    Attributes:
        xyz: Voxel means `[m, 3]`, mm.
        normals: Unit normals of either sign `[m, 3]`.
        roughness_mm: Standard deviation of the neighbours from that plane, the median over the points: noise, and some
            curvature.
        spacing_mm: Median distance to the nearest neighbour.
        reach_mm: Median distance to the furthest neighbour that a normal comes from: rounder things have no normals.
    """

    xyz: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "m 3"]
    roughness_mm: float
    spacing_mm: float
    reach_mm: float

    def subset(self, rows: np.ndarray) -> "Surface":
        """The rows alone, with the distances kept."""
        return self._replace(xyz=self.xyz[rows], normals=self.normals[rows])


def thin(xyz: Float[np.ndarray, "n 3"], *, target: int) -> Float[np.ndarray, "m 3"]:
    """Voxel means, with a voxel so large that about `target` points are left; all points if there are fewer."""
    if len(xyz) <= target:
        return xyz
    placed = xyz - xyz.min(axis=0)  # the grid has its corner there
    size = np.ptp(xyz, axis=0).max() / 1000
    while True:
        groups = voxel_groups(placed, size)
        count = len(groups.first)
        if count <= 1.1 * target:
            break
        size *= min(2.0, (count / target) ** 0.5)  # points lie on surfaces: their number falls with the square
    return groups.means(xyz)


def surface(xyz: Float[np.ndarray, "n 3"], *, target: int = 20_000, k: int = 24) -> Surface:
    """Thin a cloud and fit a plane to the `k` nearest neighbours of each point left; to fewer of few, which reach too far."""
    points = thin(xyz, target=target)
    k = min(k, max(LEAST_NEIGHBORS, len(points) // PER_NEIGHBOR))
    distance, neighbors = KDTree(points).query(points, k=k, workers=-1)
    normals, roughness = fitted_planes(covariances(points, np.asarray(neighbors), at=points))
    spacing, reach = np.median(distance[:, [1, -1]], axis=0)
    return Surface(points, normals, float(np.median(roughness)), float(spacing), float(reach))
