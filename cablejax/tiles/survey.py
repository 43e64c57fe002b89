"""The first look at a file: its points as one column of float32, their box, and how wide neighbourhoods are."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from cablejax.io import PointFileError, iter_points
from cablejax.tiles.folder import Folder

SAMPLE = 64  # points whose neighbourhoods are measured
BLOCK = 5_000  # points compared with them at once: they stay in the cache


def survey(folder: Folder, source: Path, *, unit: str, columns: str | None, chunk: int) -> dict[str, Any]:
    """Read a file once; points exactly at the origin, several of them, are beams without return and become NaN."""
    n, dropped, zeros = 0, 0, []
    lower, upper, shift = np.full(3, np.inf), np.full(3, -np.inf), np.zeros(3)
    with (folder.path / "points").open("wb") as file:
        for piece in iter_points(source, unit=unit, columns=columns, chunk=chunk):
            shift = piece.shift_mm
            at_origin = (piece.xyz_mm == 0).all(axis=1)
            zeros.extend((n + np.nonzero(at_origin)[0]).tolist())
            xyz = (piece.xyz_mm - shift).astype(np.float32)
            lower, upper = np.minimum(lower, xyz.min(axis=0)), np.maximum(upper, xyz.max(axis=0))
            file.write(xyz.tobytes())
            n, dropped = n + len(xyz), dropped + piece.dropped
    misses = len(zeros) if len(zeros) > 1 else 0
    if misses == n:
        raise PointFileError(source, f"holds no point but {n:,} at the origin")
    if misses:
        folder.column("points", np.float32, (n, 3))[zeros] = np.nan
    box = {"lower": lower.astype(float).tolist(), "upper": upper.astype(float).tolist()}
    return {"n": n, "shift": shift.tolist(), "dropped": dropped + misses, **box}


def blocks(points: Float[np.ndarray, "n 3"], size: int):
    """First rows and coordinates of the valid points, some rows at a time, with their places."""
    for start in range(0, len(points), size):
        xyz = np.asarray(points[start : start + size])
        valid = np.isfinite(xyz).all(axis=1)
        yield start + np.nonzero(valid)[0], xyz[valid]


def typical_reach(points: Float[np.ndarray, "n 3"], k: int) -> float:
    """Distance to the k-th neighbour that 19 of 20 points stay below, from a sample compared with all points."""
    rows = np.linspace(0, len(points) - 1, SAMPLE).astype(int)
    queries = np.asarray(points[rows], dtype=np.float64)
    queries = queries[np.isfinite(queries).all(axis=1)]
    best = np.full((len(queries), k + 1), np.inf)
    for _, xyz in blocks(points, BLOCK):
        if len(xyz) == 0:
            continue
        apart = np.maximum(np.maximum(xyz.min(axis=0) - queries, queries - xyz.max(axis=0)), 0.0)
        near = np.flatnonzero((apart**2).sum(axis=1) < best[:, -1])  # rows of a scan lie together: most blocks are far
        if len(near) == 0:
            continue
        square = _squares(queries[near], xyz)
        nearer = square[:, (square < best[near, -1:]).any(axis=0)]
        best[near] = np.partition(np.concatenate([best[near], nearer], axis=1), k, axis=1)[:, : k + 1]
    return float(np.quantile(np.sqrt(best[:, -1]), 0.95))


def _squares(queries: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    centre = queries.mean(axis=0)
    a, b = queries - centre, xyz.astype(np.float64) - centre
    return np.maximum((a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * a @ b.T, 0.0)
