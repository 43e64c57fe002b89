"""Clouds padded to a few capacities, so that a scan of another size runs the programs compiled for the last one."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cablejax.io import PointFile
    from cablejax.types import PointCloud

LEAST = 2048


def capacity(points: int) -> int:
    """The least of the capacities that holds so many points: 2,048, then those of `capacity_for`.

    Example:
        >>> [capacity(n) for n in (1, 2048, 2049, 51_000, 53_135)]
        [2048, 2048, 2304, 53248, 53248]
    """
    from cablejax.types import capacity_for

    return max(LEAST, capacity_for(points))


def padded(scan: "PointFile") -> "PointCloud":
    """A scan as a cloud, as `PointFile.cloud` gives it, with invalid rows up to its capacity."""
    from cablejax.types import PointCloud

    return PointCloud.from_xyz(scan.xyz_mm - scan.shift_mm, capacity=capacity(len(scan.xyz_mm)))
