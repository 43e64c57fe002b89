"""A section of a measured cable, from all of its points."""

from pathlib import Path
from typing import Any

import numpy as np

DRAWN = 4000


def section(surface: Path, *, at_mm: float, half_mm: float) -> dict[str, Any]:
    """Points of a cable within a distance along its axis, as `write_surfaces` has left them.

    Returns:
        How many there are, and at most `DRAWN` of them, every so many: `angle_deg` and `deviation_mm`.
    """
    rows = np.load(surface, mmap_mode="r")
    first, end = np.searchsorted(rows[:, 0], np.array([at_mm - half_mm, at_mm + half_mm], dtype=np.float32)).tolist()
    part = np.asarray(rows[first:end])
    drawn = part[:: max(1, -(-len(part) // DRAWN))].astype(float)
    return {
        "points": len(part),
        "angle_deg": np.round(drawn[:, 1], 3).tolist(),
        "deviation_mm": np.round(drawn[:, 2], 5).tolist(),
    }
