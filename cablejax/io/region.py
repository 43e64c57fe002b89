"""The points of a file within a box, where the file is ordered so that they can be found: COPC."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from cablejax.io.isolated import read_isolated
from cablejax.io.points import LARGEST_MM, unit_scale
from cablejax.io.raw import BadFile
from cablejax.io.sources import as_point_file_error

SIGNATURE = slice(
    377, 381
)  # the first record's user, behind the header of LAS 1.4: the COPC specification wants it there
ROUNDING = 1e-9  # of a coordinate, more than what dividing by the unit and multiplying again changes


class Region(NamedTuple):
    """Part of a file's points.

    Attributes:
        row: Their places in the file `[m]`, ascending.
        xyz_mm: Their coordinates `[m, 3]`, bit for bit as `read_points` reads them.
    """

    row: Int[np.ndarray, " m"]
    xyz_mm: Float[np.ndarray, "m 3"]


def is_copc(path: str | os.PathLike[str]) -> bool:
    """Whether a file says that it is a cloud-optimised point cloud: LAZ in the order of an octree."""
    try:
        with open(path, "rb") as file:
            head = file.read(SIGNATURE.stop)
    except OSError:
        return False
    return head.startswith(b"LASF") and head[SIGNATURE] == b"copc"


def read_region(
    path: str | os.PathLike[str],
    low_mm: Float[np.ndarray, "3"],
    high_mm: Float[np.ndarray, "3"],
    *,
    unit: str = "mm",
    time_limit_s: float | None = None,
) -> Region:
    """Read the points of a COPC file within a box; what lies in other parts of its octree is not touched.

    Args:
        path: The file.
        low_mm, high_mm: Corners `[3]`, which may be infinite; points on the sides are within.
        unit: The file's unit, as for `read_points`.
        time_limit_s: Most time that it may take, as for `read_points`.

    Raises:
        ValueError: If `unit` is unknown.
        PointFileError: If the file is damaged, no COPC, or holds points that `read_points` leaves out (withheld, or no
            finite coordinates), with which rows would not count.
    """
    path, scale = Path(path), unit_scale(unit)
    wide = np.concatenate(
        [low_mm / scale * (1 - ROUNDING * np.sign(low_mm)), high_mm / scale * (1 + ROUNDING * np.sign(high_mm))]
    )
    rows, parts = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    with as_point_file_error(path):
        limit = 30 + path.stat().st_size / 1e6 if time_limit_s is None else time_limit_s
        for raw in read_isolated("copc", path, time_limit_s=limit, box=wide.tolist()):
            with np.errstate(over="ignore"):
                xyz_mm = raw.xyz * scale
            if not (np.abs(xyz_mm) < LARGEST_MM).all():
                raise BadFile("holds coordinates that `read_points` leaves out, so that rows cannot be told")
            within = ((xyz_mm >= low_mm) & (xyz_mm <= high_mm)).all(axis=1)
            assert raw.row is not None
            rows.append(raw.row[within])
            parts.append(xyz_mm[within])
    return Region(np.concatenate(rows), np.concatenate(parts))
