"""What the page draws of a scan, made where it was measured: points, thinned, and each cable's axis, chain and surface."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Integer, UInt8

from cablejax.export.drawing import TOLERANCE, straight_pieces
from cablejax.export.tables import arc_lengths
from cablejax.io import atomic_write
from cablejax.measure import CableMeasurement
from cablejax.report.measurement import quantities

SHOWN = 400_000  # points that are drawn; up to half of them are kept for cables
AXIS_SAMPLES = 400
FRINGE, FRINGE_SIGMA = 0.08, 4.5  # radii or standard deviations about the surface within which a point is the cable's


def labels(cables: Sequence[CableMeasurement], n: int) -> UInt8[np.ndarray, " n"]:
    """The number of the cable whose surface is nearest to each point, from 1; 0 beyond the fringe of all."""
    label, nearest = np.zeros(n, dtype=np.uint8), np.full(n, np.inf)
    for number, one in enumerate(cables, 1):
        apart = np.abs(one.deviation_mm)
        fringe = max(FRINGE * one.diameter_mm / 2, FRINGE_SIGMA * one.noise_mm)
        mine = apart < np.minimum(fringe, nearest)  # NaN, far off, is not
        label[mine], nearest[mine] = number, apart[mine]
    return label


def chosen(label: Integer[np.ndarray, " n"], *, most: int = SHOWN, seed: int = 0) -> Int[np.ndarray, " k"]:
    """Rows of the points to draw, in an order of which every beginning is a fair sample.

    Those of cables fill half of the places, if they are so many, and the others the rest.
    """
    rng = np.random.default_rng(seed)
    on, off = (rng.permutation(np.flatnonzero(part)) for part in (label > 0, label == 0))
    first = on[: max(most // 2, most - len(off))]
    rest = off[: most - len(first)]
    return rng.permutation(np.concatenate([first, rest]))


def write_cloud(path: Path, xyz_mm: Float[np.ndarray, "n 3"], cables: Sequence[CableMeasurement]) -> dict[str, Any]:
    """Write points to draw: coordinates about the origin `[k, 3]` and deviations `[k]` as float32, labels `[k]` as bytes.

    A deviation is NaN where a point is no cable's.

    Returns:
        How many points are `shown` of `of`, the `origin` and the scan's `low` and `high` corner, mm.
    """
    label = labels(cables, len(xyz_mm))
    rows = chosen(label)
    origin = np.median(xyz_mm[rows], axis=0)
    deviation = np.full(len(rows), np.nan, dtype=np.float32)
    for number, one in enumerate(cables, 1):
        mine = label[rows] == number
        deviation[mine] = one.deviation_mm[rows[mine]]
    with atomic_write(path) as file:
        file.write((xyz_mm[rows] - origin).astype("<f4").tobytes())
        file.write(deviation.astype("<f4").tobytes())
        file.write(label[rows].tobytes())
    low, high = xyz_mm.min(axis=0), xyz_mm.max(axis=0)
    return {
        "shown": len(rows), "of": len(xyz_mm), "origin": origin.tolist(), "low": low.tolist(), "high": high.tolist(),
    }  # fmt: skip


def write_surfaces(folder: Path, cables: Sequence[CableMeasurement]) -> None:
    """Write the surface of each cable, whole: place along, angle about the axis and deviation `[k, 3]`, in order along."""
    label = labels(cables, len(cables[0].keep)) if cables else None
    for number, one in enumerate(cables, 1):
        rows = np.flatnonzero(label == number)
        surface = np.stack([one.along_mm[rows], one.angle_deg[rows], one.deviation_mm[rows]], axis=1)
        with atomic_write(folder / f"surface-{number}.npy") as file:
            np.save(file, surface[np.argsort(surface[:, 0])].astype(np.float32))


def cable_view(number: int, measured: CableMeasurement) -> dict[str, Any]:
    """A cable for the page: its numbers, its axis thinned, and the corners of its chain of cylinders."""
    axis, along = measured.axis_mm, arc_lengths(measured.axis_mm)
    kept = np.unique(np.linspace(0, len(axis) - 1, min(AXIS_SAMPLES, len(axis))).astype(int))
    return {
        "number": number,
        **measured.to_dict(),
        "axis_mm": axis[kept].tolist(),
        "along_mm": along[kept].tolist(),
        "pieces_mm": straight_pieces(axis, TOLERANCE * measured.diameter_mm).tolist(),
        "quantities": quantities(measured),  # pyright: ignore[reportArgumentType] frozen, its attributes could be set
    }
