"""Clouds thinned to voxel means, level by level."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from cablejax.geometry.normals import covariances_within, least_direction, plain_tree
from cablejax.geometry.voxels import voxel_groups

AROUND = 2.5  # voxels within which neighbours tell the normal: some twenty on a surface that fills its voxels
FEWEST, INSTEAD = 8, 20  # where there are fewer neighbours than these, so many of the nearest


class Thinned(NamedTuple):
    """A thinned cloud with the shape of the surface about each of its points.

    Attributes:
        xyz: Means `[m, 3]`.
        points: Number of points behind each `[m]`.
        spread: Entries xx, yy, zz, xy, xz, yz of the covariance of the surroundings `[m, 6]`, where it was asked for.
        tree: Over the means, where one was built for that.
    """

    xyz: Float[np.ndarray, "m 3"]
    points: Float[np.ndarray, " m"]
    spread: Float[np.ndarray, "m 6"] | None
    tree: KDTree | None = None

    def normals(self) -> Float[np.ndarray, "m 3"]:
        """Unit normals of either sign; zeros where the spread is not known."""
        return np.zeros_like(self.xyz) if self.spread is None else least_direction(self.spread)


def _coarser(fine: Thinned, size: float) -> Thinned:
    """Voxel means of voxel means, each worth its points. Their surroundings are the mean of those within, and what the
    means within scatter about their own."""
    groups = voxel_groups(fine.xyz, size)
    count, rows = groups.sums(fine.points), groups.sizes()
    xyz = groups.sums(fine.points[:, None] * fine.xyz) / count[:, None]
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
            groups = voxel_groups(xyz, size)
            means = groups.means(xyz)
            shape, tree = None, None
            if spread:
                tree = plain_tree(means)
                shape = covariances_within(means, tree, radius=AROUND * size, least=FEWEST, k=INSTEAD)
            done[size] = Thinned(means, groups.sizes(), shape, tree)
        else:
            done[size] = _coarser(done[max(done)], size)
    return [done[float(size)] for size in sizes]
