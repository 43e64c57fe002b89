"""Scans made from one depth image: how that shows, and what such a camera does to a round section.

A depth image becomes points by x = (column - cx) z / fx. Seen from the camera the points then lie on the pixels' grid, which
nothing else does. It is the grid of a lens without distortion; where the image was not rectified before, all points lie
aside of where they belong, the more the further from the middle of the picture, and a round section comes out oval. And a
depth is found by comparing some pixels about it, so that the picture is blurred, and thin things lose their rims.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Standard deviation of the first radial coefficient of a lens whose distortion may have been left in. The published ones of the
# three TUM RGB-D cameras (with the second one, at a third of the focal length from the middle) come to 0.16, 0.14 and 0; the
# holes in the table under the Zivid camera of the steel parts to -0.07 (docs/measure.md).
LENS_STD = 0.1
WINDOW_PX = 1.5  # standard deviation of the blur: 5 pixels, the smallest windows in use, have one of 1.4
LEAST_COLUMNS = 12
PER_COLUMN = 2.0  # points in a column, on average, without which a grid cannot be told from chance
OFF_GRID = 0.05  # of the pitch in the root mean square; points in no order are .29 off
LEAST_FILL = 0.005  # of the pixels between the outermost: a turned grid has far more lines than points
LARGE_GAPS = 10  # of the gaps between columns, the one by which columns are told from rounding


class DepthImage(NamedTuple):
    """The pinhole camera of a scan, in its zero and along z: focal lengths in pixels, along x and y."""

    focal_x_px: float
    focal_y_px: float

    def pitch_mm(self, distance_mm: float) -> float:
        """Distance between neighbouring pixels' points at a distance."""
        return distance_mm / float(np.sqrt(self.focal_x_px * self.focal_y_px))


def pixel_grid(xyz: Float[np.ndarray, "n 3"]) -> DepthImage | None:
    """The pinhole camera at the origin, looking along z either way, on whose pixels points lie; None where they do not.

    Args:
        xyz: Points `[n, 3]` in the file's own coordinates, any unit. Moved or turned ones are on no such grid.

    Example:
        >>> column, row = np.meshgrid(np.arange(40), np.arange(30))
        >>> z = 500 + 20 * np.random.default_rng(0).normal(size=column.size)
        >>> xyz = np.stack([(column.ravel() - 20) * z / 600, (row.ravel() - 15) * z / 600, z], axis=1)
        >>> camera = pixel_grid(xyz)
        >>> round(camera.focal_x_px), pixel_grid(xyz + np.array([30.0, 0.0, 0.0]))
        (600, None)
    """
    z = xyz[:, 2]
    if not ((z > 0).all() or (z < 0).all()):
        return None
    columns, rows = _lines(xyz[:, 0] / z), _lines(xyz[:, 1] / z)
    if columns is None or rows is None or len(z) < LEAST_FILL * columns[1] * rows[1]:
        return None
    return DepthImage(1 / columns[0], 1 / rows[0])


def _lines(value: Float[np.ndarray, " n"]) -> tuple[float, int] | None:
    """Distance and number of the evenly spaced lines that numbers lie on but for rounding; None if there are none."""
    ordered = np.sort(value)
    gaps = np.diff(ordered)
    if len(gaps) < LEAST_COLUMNS * PER_COLUMN:
        return None
    large = np.sort(gaps)[-LARGE_GAPS:][0]
    if not large > 0:
        return None
    pitch = float(np.quantile(gaps[gaps > 0.2 * large], 0.1))  # columns may be missing: the least of the large gaps
    column = np.concatenate([[0.0], np.cumsum(np.round(gaps / pitch))])
    if not LEAST_COLUMNS <= column[-1] <= len(value) / PER_COLUMN:
        return None
    slope, start = np.polyfit(column, ordered, 1)
    if np.std(ordered - start - slope * column) > OFF_GRID * slope:
        return None
    return float(slope), int(column[-1]) + 1


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


def blurred(aside: Float[np.ndarray, " n"], radius: float, blur: float, *, nodes: int = 15) -> Float[np.ndarray, " n"]:
    """How far before its axis a blurred picture shows a cylinder that lies on a floor `[n]`.

    Args:
        aside: Distance of each line of sight from the axis.
        radius: Of the cylinder.
        blur: Standard deviation of a Gaussian blur across the line of sight.
        nodes: Of the quadrature.
    """
    places, weights = np.polynomial.hermite_e.hermegauss(nodes)
    met = aside[:, None] + blur * places
    height = np.where(np.abs(met) < radius, np.sqrt(np.maximum(radius**2 - met**2, 0.0)), -radius)
    return height @ (weights / weights.sum())
