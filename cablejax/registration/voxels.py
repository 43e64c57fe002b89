"""Voxel means: one point for every cube of a grid that holds any, and clouds thinned level by level."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from cablejax.registration.normals import least_direction, plain_tree, spread_within

AROUND = 2.5  # voxels within which neighbours tell the normal: some twenty on a surface that fills its voxels
FEWEST, INSTEAD = 8, 20  # where there are fewer neighbours than these, so many of the nearest


class Thinned(NamedTuple):
    """A thinned cloud with the shape of the surface about each of its points.

    Attributes:
        xyz: Means `[m, 3]`.
        count: Number of points behind each `[m]`.
        spread: Entries xx, yy, zz, xy, xz, yz of the covariance of the surroundings `[m, 6]`, where it was asked for.
        tree: Over the means, where one was built for that.
    """

    xyz: Float[np.ndarray, "m 3"]
    count: Float[np.ndarray, " m"]  # pyright: ignore[reportIncompatibleMethodOverride]
    spread: Float[np.ndarray, "m 6"] | None
    tree: KDTree | None = None

    def normals(self) -> Float[np.ndarray, "m 3"]:
        """Unit normals of either sign; zeros where the spread is not known."""
        return np.zeros_like(self.xyz) if self.spread is None else least_direction(self.spread)


class _Groups(NamedTuple):
    """Rows in the order of their voxels `[n]`, and where in that order each voxel begins `[m]`."""

    order: Int[np.ndarray, " n"]
    first: Int[np.ndarray, " m"]

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sum of each voxel's rows `[n]`, or of each of their columns `[n, c]`: one by one, which is much faster."""
        if values.ndim == 1:
            return np.add.reduceat(values[self.order], self.first)
        return np.stack([np.add.reduceat(column[self.order], self.first) for column in values.T], axis=1)

    def sizes(self) -> np.ndarray:
        """Number of each voxel's rows."""
        return np.diff(np.append(self.first, len(self.order))).astype(float)


def _grouped(xyz: np.ndarray, size: float) -> _Groups:
    """Rows by voxel, in the order of x, then y, then z.

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
    return _Groups(order, np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])))


def voxel_means(xyz: Float[np.ndarray, "n 3"], size: float | int) -> Float[np.ndarray, "m 3"]:
    """The mean of the points in each voxel of side `size`.

    Raises:
        ValueError: If `size` is not positive.

    Example:
        >>> voxel_means(np.array([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [1.5, 0.0, 0.0]]), 1.0).round(3).tolist()
        [[0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    """
    if len(xyz) == 0:
        return xyz
    groups = _grouped(xyz, size)
    return groups.sums(xyz) / groups.sizes()[:, None]


def _coarser(fine: Thinned, size: float) -> Thinned:
    """Voxel means of voxel means, each worth its points. Their surroundings are the mean of those within, and what the
    means within scatter about their own."""
    groups = _grouped(fine.xyz, size)
    count, rows = groups.sums(fine.count), groups.sizes()
    xyz = groups.sums(fine.count[:, None] * fine.xyz) / count[:, None]
    if fine.spread is None:
        return Thinned(xyz, count, None)
    voxel = np.empty(len(fine.xyz), np.int64)
    voxel[groups.order] = np.repeat(np.arange(len(rows)), rows.astype(np.int64))
    x, y, z = (fine.xyz - xyz[voxel]).T
    apart = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)
    total = groups.sums(fine.spread + apart)
    return Thinned(xyz, count, total / rows[:, None])


def voxel_pyramid(xyz: Float[np.ndarray, "n 3"], sizes: Sequence[float | int], *, spread: bool) -> list[Thinned]:
    """The cloud thinned to each of some voxel sizes: the finest from the points, each other from the next finer one.

    Where a size is a multiple of the next finer one these are the means of the points in each voxel; else points near a
    voxel's border may count to its neighbour.

    Args:
        xyz: Points `[n, 3]`, at least one.
        sizes: Sides of the voxels, in the order of the result.
        spread: Whether to find the spread: at the finest level the covariance of the means around.

    Raises:
        ValueError: If a size is not positive.
    """
    done: dict[float, Thinned] = {}
    for size in sorted({float(size) for size in sizes}):
        if not done:
            groups = _grouped(xyz, size)
            means = groups.sums(xyz) / groups.sizes()[:, None]
            shape, tree = None, None
            if spread:
                tree = plain_tree(means)
                shape = spread_within(means, tree, radius=AROUND * size, least=FEWEST, k=INSTEAD)
            done[size] = Thinned(means, groups.sizes(), shape, tree)
        else:
            done[size] = _coarser(done[max(done)], size)
    return [done[float(size)] for size in sizes]
