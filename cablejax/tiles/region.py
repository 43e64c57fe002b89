"""Tiles that fetch their own points, from a file that is ordered so that they can (COPC)."""

from pathlib import Path
from typing import Any

import numpy as np

from cablejax.io import is_copc, read_region
from cablejax.tiles.folder import TilePoints
from cablejax.tiles.plan import Tile

SLACK = 1e-6  # of the cloud's reach, more than what rounding to float32 moves a point


def region_of(source: Path, unit: str, about: dict[str, Any]) -> dict[str, Any] | None:
    """What `fetched` needs beside the tile; None where points cannot be fetched, or returns were left out of their rows.

    Args:
        source: The file.
        unit: Its unit.
        about: As `survey` found it.
    """
    if about["dropped"] or not is_copc(source):
        return None
    reach = float(np.abs([about["lower"], about["upper"]]).max())
    return {"source": str(source.resolve()), "unit": unit, "shift": about["shift"], "slack": SLACK * reach}


def fetched(tile: Tile, *, source: str, unit: str, shift: list[float], slack: float) -> TilePoints:
    """The points of a tile and its halo, bit for bit those of a pass over the whole file, in the same order.

    Raises:
        PointFileError: As `read_region`.
    """
    wider, at = tile.halo + slack, np.array(shift)
    row, xyz_mm = read_region(source, tile.lower - wider + at, tile.upper + wider + at, unit=unit)
    xyz = (xyz_mm - at).astype(np.float32)
    wide = xyz.astype(np.float64)
    near = tile.outer(wide)
    return TilePoints(row[near], xyz[near], tile.inner(wide[near]))
