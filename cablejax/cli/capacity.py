"""Clouds padded to a few capacities, so that a scan of another size runs the programs compiled for the last one."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cablejax.io import PointFile
    from cablejax.types import PointCloud

LEAST = 2048
DOUBLING = 1 << 18  # up to here the next power of two: a cloud twice as long costs a second or two, its programs twenty


def capacity(points: int) -> int:
    """The least of the capacities that holds so many points: powers of two from 2,048, then those of `capacity_for`.

    Example:
        >>> [capacity(n) for n in (1, 2049, 53_135, 61_000, 262_144, 262_145)]
        [2048, 4096, 65536, 65536, 262144, 294912]
    """
    from cablejax.types import capacity_for

    doubled = max(LEAST, 1 << max(points - 1, 0).bit_length())
    return doubled if doubled <= DOUBLING else capacity_for(points)


def padded(scan: "PointFile") -> "PointCloud":
    """A scan as a cloud, as `PointFile.cloud` gives it, with invalid rows up to its capacity."""
    from cablejax.types import PointCloud

    return PointCloud.from_xyz(scan.xyz_mm - scan.shift_mm, capacity=capacity(len(scan.xyz_mm)))
