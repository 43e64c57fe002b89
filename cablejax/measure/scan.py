"""The points of a scan that are looked at, near the origin in float64, and the rows they come from."""

import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeGuard

import numpy as np
from jaxtyping import Bool, Float, Int

from cablejax.measure.depth_image import DepthImage, pixel_grid
from cablejax.measure.messages import check_box, check_cloud, check_labels
from cablejax.measure.settings import MeasureSettings, SearchLimits

if TYPE_CHECKING:
    from cablejax.types import PointCloud


@dataclass(frozen=True)
class Scan:
    """What a search and its fits are given.

    Attributes:
        xyz: Points that are looked at `[m, 3]`, mm, less `origin`: keeps the arithmetic near zero.
        rows: Their rows in the scan as given `[m]`.
        station: Number of the scanner position of each `[m]`; None if unknown.
        origin: Where zero lies `[3]`, mm.
        count: Rows of the scan as given.
        camera: The one on whose pixels the points lie, in the zero of the scan as given; None if they lie on none.
    """

    xyz: Float[np.ndarray, "m 3"]
    rows: Int[np.ndarray, " m"]
    station: Int[np.ndarray, " m"] | None
    origin: Float[np.ndarray, "3"]
    count: int
    camera: DepthImage | None = None

    def subset(self, keep: Bool[np.ndarray, " m"]) -> "Scan":
        """The points that are kept alone."""
        station = None if self.station is None else self.station[keep]
        return replace(self, xyz=self.xyz[keep], rows=self.rows[keep], station=station)

    def views(self, settings: MeasureSettings) -> MeasureSettings:
        """The settings with what the points themselves tell: a depth image is a single view, unless stations are given."""
        if self.camera is None or self.station is not None or settings.stations is not None:
            return settings
        return replace(settings, stations=1)

    def moved(self, limits: SearchLimits) -> SearchLimits:
        """The limits with their point in the coordinates of `xyz`."""
        if limits.near_mm is None:
            return limits
        x, y, z = np.array(limits.near_mm) - self.origin
        return replace(limits, near_mm=(float(x), float(y), float(z)))


def scan_of(
    cloud_or_xyz_mm: "PointCloud | np.ndarray",
    *,
    station: np.ndarray | None,
    on_cable: np.ndarray | None,
    limits: SearchLimits,
) -> Scan:
    """The valid points of a scan: padding, NaN, what is labelled as something else and what lies outside the box are left out.

    Raises:
        MeasureError: If they are too few, all equal, or all on one line.
        ValueError: If an argument has not the shape it should have.
    """
    every, valid = _points(cloud_or_xyz_mm)
    if on_cable is not None:
        on_cable = np.asarray(on_cable)
        if on_cable.shape != valid.shape or on_cable.dtype != bool:
            raise ValueError(
                f"on_cable: expected {len(valid)} truth values, got {on_cable.dtype} {list(on_cable.shape)}"
            )
        check_labels(valid, on_cable)
        valid = valid & on_cable
    if station is not None and np.shape(station) != valid.shape:
        raise ValueError(f"station: expected shape [{len(valid)}], got {list(np.shape(station))}")
    if limits.box_mm is not None:
        low, high = np.sort(np.array(limits.box_mm, dtype=float), axis=0)
        within = valid & (every >= low).all(axis=1) & (every <= high).all(axis=1)
        check_box(valid, within)
        valid = within
    check_cloud(every[valid], len(every))
    origin = np.median(every[valid], axis=0)
    return Scan(
        xyz=every[valid] - origin,
        rows=np.flatnonzero(valid),
        station=None if station is None else np.asarray(station)[valid],
        origin=origin,
        count=len(every),
        camera=pixel_grid(every[valid]),
    )


def _is_padded(cloud: object) -> TypeGuard["PointCloud"]:
    """Whether it is a `PointCloud`, asked without jax: who has none has not imported its type."""
    types = sys.modules.get("cablejax.types")
    return types is not None and isinstance(cloud, types.PointCloud)


def _points(cloud_or_xyz_mm: "PointCloud | np.ndarray") -> tuple[np.ndarray, np.ndarray]:
    """All points in float64, and which of them are points at all: padding and NaN are not."""
    if _is_padded(cloud_or_xyz_mm):
        xyz = np.asarray(cloud_or_xyz_mm.xyz, dtype=np.float64)
        valid = np.array(cloud_or_xyz_mm.mask)
    else:
        xyz = np.asarray(cloud_or_xyz_mm, dtype=np.float64)
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise ValueError(f"cloud_or_xyz_mm: expected shape [n, 3], got {list(xyz.shape)}")
        valid = np.ones(len(xyz), dtype=bool)
    return xyz, valid & np.isfinite(xyz).all(axis=1)
