"""Voxel means: one point for every cube of a grid that holds any."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class VoxelGroups(NamedTuple):
    """Rows in the order of their voxels `[n]`, and where in that order each voxel begins `[m]`."""

    order: Int[np.ndarray, " n"]
    first: Int[np.ndarray, " m"]

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sum of each voxel's rows `[n]`, or of each of their columns `[n, c]`: one by one, which is much faster."""
        if values.ndim == 1:
            return np.add.reduceat(values[self.order], self.first)
        return np.stack([np.add.reduceat(column[self.order], self.first) for column in values.T], axis=1)

    def sizes(self) -> Float[np.ndarray, " m"]:
        """Number of each voxel's rows."""
        return np.diff(np.append(self.first, len(self.order))).astype(float)

    def means(self, xyz: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
        """Mean of each voxel's points."""
        return self.sums(xyz) / self.sizes()[:, None]


def voxel_groups(xyz: Float[np.ndarray, "n 3"], size: float | int) -> VoxelGroups:
    """Rows by voxel, in the order of x, then y, then z; the grid has a corner at the origin.

    Raises:
        ValueError: If `size` is not positive, or the grid has more voxels than 64 bits can number.
    """
    if not size > 0:
        raise ValueError(f"size: expected a positive number, got {size}")
    places = [np.floor(np.ascontiguousarray(column) / size) for column in xyz.T]
    places = [place - place.min() for place in places]
    spans = [int(place.max()) + 1 for place in places]
    if spans[0] * spans[1] * spans[2] >= 2**63:
        raise ValueError(f"size: expected larger voxels, {' x '.join(map(str, spans))} of them are too many to number")
    x, y, z = (place.astype(np.int64) for place in places)
    keys = (x * spans[1] + y) * spans[2] + z
    order = np.argsort(keys)
    ordered = keys[order]
    return VoxelGroups(order, np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])))


def voxel_means(xyz: Float[np.ndarray, "n 3"], size: float | int) -> Float[np.ndarray, "m 3"]:
    """The mean of the points in each voxel of side `size`.

    Raises:
        ValueError: If `size` is not positive.

    Example:
        >>> voxel_means(np.array([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [1.5, 0.0, 0.0]]), 1.0).round(3).tolist()
        [[0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    """
    return xyz if len(xyz) == 0 else voxel_groups(xyz, size).means(xyz)
