"""Voxel means: one point for every cube of a grid that holds any."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class _Cells(NamedTuple):
    """Sums over the voxels that hold points: grid place `[m, 3]`, sum of coordinates `[m, 3]`, number of points `[m]`."""

    place: Int[np.ndarray, "m 3"]
    total: Float[np.ndarray, "m 3"]
    count: Float[np.ndarray, " m"]


def _keys(place: np.ndarray) -> np.ndarray:
    """A number for every voxel, in the order of x, then y, then z.

    Raises:
        ValueError: If the grid has more voxels than 64 bits can number.
    """
    shifted = place - place.min(axis=0)
    spans = [int(span) + 1 for span in shifted.max(axis=0)]
    if spans[0] * spans[1] * spans[2] >= 2**63:
        raise ValueError(f"size: expected larger voxels, {' x '.join(map(str, spans))} of them are too many to number")
    return (shifted[:, 0] * spans[1] + shifted[:, 1]) * spans[2] + shifted[:, 2]


def _gathered(place: np.ndarray, total: np.ndarray, count: np.ndarray | None) -> _Cells:
    """Rows of the same voxel added up."""
    keys = _keys(place)
    order = np.argsort(keys)
    ordered = keys[order]
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    sizes = np.diff(np.append(first, len(keys))).astype(float) if count is None else np.add.reduceat(count[order], first)
    return _Cells(place[order[first]], np.add.reduceat(total[order], first, axis=0), sizes)


def _check(size: float | int) -> None:
    if not size > 0:
        raise ValueError(f"size: expected a positive number, got {size}")


def voxel_means(xyz: Float[np.ndarray, "n 3"], size: float | int) -> Float[np.ndarray, "m 3"]:
    """The mean of the points in each voxel of side `size`.

    Raises:
        ValueError: If `size` is not positive.

    Example:
        >>> voxel_means(np.array([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [1.5, 0.0, 0.0]]), 1.0).round(3).tolist()
        [[0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    """
    return voxel_pyramid(xyz, [size])[0]


def voxel_pyramid(xyz: Float[np.ndarray, "n 3"], sizes: Sequence[float | int]) -> list[Float[np.ndarray, "m 3"]]:
    """Voxel means for each of some sizes. One that is a multiple of a finer one is made from that one's sums.

    Raises:
        ValueError: If a size is not positive.
    """
    done: dict[float, _Cells] = {}
    for size in sorted({float(size) for size in sizes}):
        _check(size)
        finer = next((known for known in reversed(done) if (size / known).is_integer()), None)
        if len(xyz) == 0:
            done[size] = _Cells(np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros(0))
        elif finer is None:
            done[size] = _gathered(np.floor(xyz / size).astype(np.int64), xyz, None)
        else:
            cells = done[finer]
            done[size] = _gathered(cells.place // int(size / finer), cells.total, cells.count)
    return [done[float(size)].total / done[float(size)].count[:, None] for size in sizes]
