"""One point per voxel, normals and local noise: what the search for a cable looks at."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree


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


def voxel_groups(xyz: Float[np.ndarray, "n 3"], size: float) -> Int[np.ndarray, " n"]:
    """The number of each point's voxel, from 0 without gaps."""
    cells = np.floor((xyz - xyz.min(axis=0)) / size).astype(np.int64)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)


def thin(xyz: Float[np.ndarray, "n 3"], *, target: int) -> Float[np.ndarray, "m 3"]:
    """Voxel means, with a voxel so large that about `target` points are left; all points if there are fewer."""
    if len(xyz) <= target:
        return xyz
    size = np.ptp(xyz, axis=0).max() / 1000
    while True:
        groups = voxel_groups(xyz, size)
        count = int(groups.max()) + 1
        if count <= 1.1 * target:
            break
        size *= min(2.0, (count / target) ** 0.5)  # points lie on surfaces: their number falls with the square
    sums = np.stack([np.bincount(groups, weights=xyz[:, axis], minlength=count) for axis in range(3)], axis=1)
    return sums / np.bincount(groups, minlength=count)[:, None]


def surface(xyz: Float[np.ndarray, "n 3"], *, target: int = 20_000, k: int = 24) -> Surface:
    """Thin a cloud and fit a plane to the `k` nearest neighbours of each point left."""
    points = thin(xyz, target=target)
    k = min(k, len(points))
    distance, neighbors = KDTree(points).query(points, k=k, workers=-1)
    spread = points[neighbors] - points[neighbors].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("mki,mkj->mij", spread, spread) / k)
    roughness = float(np.median(np.sqrt(np.maximum(values[:, 0], 0))))
    spacing, reach = np.median(distance[:, [1, -1]], axis=0)
    return Surface(points, vectors[:, :, 0], roughness, float(spacing), float(reach))
