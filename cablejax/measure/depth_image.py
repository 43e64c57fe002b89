"""Scans made from one depth image: how that shows, and the lens distortion that they may still hold.

A depth image becomes points by x = (column - cx) z / fx. Seen from the camera the points then lie on the pixels' grid, which
nothing else does. It is the grid of a lens without distortion; where the image was not rectified before, all points lie
aside of where they belong, the more the further from the middle of the picture, and a round section comes out oval.
"""

import numpy as np
from jaxtyping import Float

# Standard deviation of the first radial coefficient of a lens whose distortion may be left. Published calibrations of the
# TUM RGB-D cameras come to 0.17, 0.16, -0.01 and -0.10 a third of the focal length off the middle, those of its third camera to 0
# (rectified); the holes of the table under the Zivid camera of the steel parts (`docs/measure.md`) give -0.07.
LENS_STD = 0.1
LEAST_COLUMNS = 8
PER_COLUMN = 2.0  # points in a column, on average, without which a grid cannot be told from chance
OFF_GRID = 0.1  # of the pitch in the root mean square; points in no order are .29 off
LARGE_GAPS = 10  # of the gaps between columns, the one by which columns are told from rounding


def on_pixel_grid(xyz: Float[np.ndarray, "n 3"]) -> bool:
    """Whether points lie on the grid of a pinhole camera at the origin that looks along z, either way.

    Args:
        xyz: Points `[n, 3]` in the file's own coordinates, any unit. Moved or turned ones are on no such grid.

    Example:
        >>> column, row = np.meshgrid(np.arange(40), np.arange(30))
        >>> z = 500 + np.random.default_rng(0).normal(size=column.size)
        >>> xyz = np.stack([(column.ravel() - 20) * z / 600, (row.ravel() - 15) * z / 600, z], axis=1)
        >>> on_pixel_grid(xyz), on_pixel_grid(xyz + [1.0, 0.0, 0.0])
        (True, False)
    """
    z = xyz[:, 2]
    if not ((z > 0).all() or (z < 0).all()):
        return False
    return _on_lines(xyz[:, 0] / z) and _on_lines(xyz[:, 1] / z)


def _on_lines(value: Float[np.ndarray, " n"]) -> bool:
    """Whether numbers are whole multiples of one pitch, but for a constant and rounding."""
    ordered = np.sort(value)
    gaps = np.diff(ordered)
    if len(gaps) < LEAST_COLUMNS * PER_COLUMN:
        return False
    large = np.sort(gaps)[-LARGE_GAPS:][0]
    steps = gaps[gaps > 0.5 * large]
    pitch = float(np.median(steps))
    if not pitch > 0:
        return False
    column = np.concatenate([[0.0], np.cumsum(np.round(gaps / pitch))])
    if not LEAST_COLUMNS <= column[-1] <= len(value) / PER_COLUMN:
        return False
    slope, start = np.polyfit(column, ordered, 1)
    return bool(np.std(ordered - start - slope * column) < OFF_GRID * slope)


def undistorted(xyz: Float[np.ndarray, "n 3"], coefficient: float) -> Float[np.ndarray, "n 3"]:
    """Points of a depth image where they belong if its lens had a radial distortion of one coefficient.

    Brown's model, x_seen = x (1 + k r^2) for x = X / Z and r the distance from the middle; its inverse by fixed-point
    iterations. Depths stay.

    Args:
        xyz: Points `[n, 3]` in the camera's coordinates.
        coefficient: k; negative for a barrel.
    """
    z = xyz[:, 2:]
    seen = xyz[:, :2] / z
    place = seen
    for _ in range(10):
        place = seen / (1 + coefficient * np.sum(place**2, axis=1, keepdims=True))
    return np.concatenate([place * z, z], axis=1)
