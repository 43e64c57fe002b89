"""The scan with each point's distance from the fitted surface: PLY with scalar fields, LAS and LAZ with extra bytes."""

import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float

from cablejax.io import atomic_write
from cablejax.io.points import unit_scale
from cablejax.io.sinks import las_step, native_errors
from cablejax.measure import CableMeasurement
from cablejax.optional import require

# Beside the coordinates, in this order: name, type in PLY and LAS, meaning.
FIELDS = (
    ("deviation_mm", "f4", "distance from surface, mm"),
    ("along_mm", "f4", "place along the axis, mm"),
    ("angle_deg", "f4", "angle about axis, degrees"),
    ("on_cable", "u1", "1 where a point of the cable"),
)
PLY_NAMES = {"f8": "double", "f4": "float", "u1": "uchar"}


def write_deviations(
    path: str | os.PathLike[str], measured: CableMeasurement, xyz_mm: Float[np.ndarray, "n 3"], *, unit: str = "mm"
) -> None:
    """Write the scan's points with their deviation, place along the axis, angle about it, and whether they are the cable's.

    Deviations are positive outside; what lies far off the cable has NaN.

    Args:
        path: Ending in .ply, .las or .laz; replaced in one step.
        measured: The measurement of the scan.
        xyz_mm: The scan's points `[n, 3]`, in the order that was measured.
        unit: Of the coordinates in the file; the fields stay in mm and degrees.

    Raises:
        ValueError: If the ending is another, or the points are not as many as were measured.
        MissingPackageError: If LAS or LAZ is asked for without laspy.
        OSError: If the file cannot be written.
    """
    ending = Path(path).suffix.lower()
    if ending not in (".ply", ".las", ".laz"):
        raise ValueError(f"path: expected the ending .ply, .las or .laz, got {os.fspath(path)!r}")
    xyz = np.asarray(xyz_mm, dtype=np.float64) / unit_scale(unit)
    values = [measured.deviation_mm, measured.along_mm, measured.angle_deg, measured.keep]
    if xyz.shape != (len(measured.keep), 3):
        raise ValueError(f"xyz_mm: expected the {len(measured.keep)} points that were measured, got {list(xyz.shape)}")
    if ending != ".ply":
        require("laspy", why="LAS or LAZ")
    with atomic_write(path) as file:
        if ending == ".ply":
            _write_ply(file, xyz, values)
        else:
            _write_las(file, xyz, values, compressed=ending == ".laz")


def _write_ply(file: BinaryIO, xyz: np.ndarray, values: list[Any]) -> None:
    record = [(axis, "f8") for axis in "xyz"] + [(name, kind) for name, kind, _ in FIELDS]
    rows = np.empty(len(xyz), np.dtype([(name, f"<{kind}") for name, kind in record]))
    for (name, _), column in zip(record, [*xyz.T, *values], strict=True):
        rows[name] = column
    lines = ["ply", "format binary_little_endian 1.0", "comment written by cablejax", f"element vertex {len(xyz)}"]
    lines += [f"property {PLY_NAMES[kind]} {name}" for name, kind in record]
    file.write(("\n".join([*lines, "end_header"]) + "\n").encode())
    file.write(rows.tobytes())


def _write_las(file: BinaryIO, xyz: np.ndarray, values: list[Any], *, compressed: bool) -> None:
    import laspy

    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets = np.round((xyz.min(axis=0) + xyz.max(axis=0)) / 2)
    header.scales = np.full(3, las_step(xyz))
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind, description) for name, kind, description in FIELDS])
    points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
    points.x, points.y, points.z = xyz.T
    for (name, _, _), column in zip(FIELDS, values, strict=True):
        points[name] = column
    with native_errors(), laspy.LasWriter(file, header, do_compress=compressed, closefd=False) as writer:
        writer.write_points(points)
