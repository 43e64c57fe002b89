"""The axis and the sections along it as CSV tables, in mm."""

import csv
import io
import os
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from cablejax.geometry.robust import COVERAGE
from cablejax.io import atomic_write
from cablejax.measure import CableMeasurement

AXIS = ("along_mm", "x_mm", "y_mm", "z_mm", "direction_x", "direction_y", "direction_z")
SECTIONS = (
    "along_mm", "x_mm", "y_mm", "z_mm", "diameter_mm", "low_mm", "high_mm", "minimum_mm", "maximum_mm", "arc_deg", "points",
)  # fmt: skip


def arc_lengths(axis_mm: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
    """Distance of each sample of an axis from the first, along it."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis_mm, axis=0), axis=1))])


def write_axis(path: str | os.PathLike[str], measured: CableMeasurement) -> None:
    """Samples of the axis with their distance along it and its direction there, in the coordinates of the scan.

    Raises:
        OSError: If the file cannot be written.
    """
    axis = measured.axis_mm
    along = arc_lengths(axis)
    direction = np.gradient(axis, along, axis=0)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    _write(path, AXIS, np.column_stack([along, axis, direction]))


def write_sections(path: str | os.PathLike[str], measured: CableMeasurement) -> None:
    """Sections along the axis: middle, diameter with its 95 % interval, least and greatest diameter; empty where unknown.

    Raises:
        OSError: If the file cannot be written.
    """
    found, along = measured.sections, arc_lengths(measured.axis_mm)
    middle = [np.interp(found.s_mm, along, measured.axis_mm[:, axis]) for axis in range(3)]
    half = COVERAGE * found.std_mm
    columns = [found.s_mm, *middle, found.diameter_mm, found.diameter_mm - half, found.diameter_mm + half]
    columns += [found.minimum_mm, found.maximum_mm, found.arc_deg, found.points]
    _write(path, SECTIONS, np.column_stack(columns))


def _write(path: str | os.PathLike[str], names: Sequence[str], rows: Iterable[np.ndarray]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(["" if np.isnan(cell) else repr(float(cell)) for cell in row] for row in rows)
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())
