"""What every reader hands back, in the file's own unit, and the one error that every reader raises."""

import os
from typing import NamedTuple

import numpy as np


class PointFileError(Exception):
    """A file cannot be read or written as a point cloud: path and reason in one sentence.

    Args:
        path: The file.
        reason: Why, worded to stand after a colon.
    """

    def __init__(self, path: str | os.PathLike[str], reason: str):
        super().__init__(f"{os.fspath(path)}: {reason}")
        self.path = os.fspath(path)
        self.reason = reason

    def __reduce__(self) -> tuple[type["PointFileError"], tuple[str, str]]:
        return PointFileError, (self.path, self.reason)


class BadFile(ValueError):
    """The reason why a parser gives up; `read_points` adds the path."""


class RawCloud(NamedTuple):
    """Points as a file holds them.

    Attributes:
        xyz: Coordinates `[n, 3]`, float64, in the file's unit; rows may hold NaN.
        color: Red, green, blue `[n, 3]`, uint8 or uint16 as in the file, or None.
        intensity: Reflected intensity `[n]`, float32, in the file's own scale, or None.
        dropped: Returns that the format marks as invalid, already left out.
    """

    xyz: np.ndarray
    color: np.ndarray | None = None
    intensity: np.ndarray | None = None
    dropped: int = 0


def join(clouds: list[RawCloud]) -> RawCloud:
    """Several scans or pieces of one file as one cloud; colours and intensity stay where every one has them."""
    dropped = sum(cloud.dropped for cloud in clouds)
    filled = [cloud for cloud in clouds if len(cloud.xyz)]
    if len(filled) < 2:
        return (filled[0] if filled else RawCloud(np.zeros((0, 3))))._replace(dropped=dropped)
    color = intensity = None
    if all(cloud.color is not None for cloud in filled):
        colors = [cloud.color for cloud in filled if cloud.color is not None]
        wide = len({part.dtype for part in colors}) > 1
        color = np.concatenate([as_uint16(part) if wide else part for part in colors])
    if all(cloud.intensity is not None for cloud in filled):
        intensity = np.concatenate([cloud.intensity for cloud in filled if cloud.intensity is not None])
    return RawCloud(np.concatenate([cloud.xyz for cloud in filled]), color, intensity, dropped)


def as_color(values: np.ndarray) -> np.ndarray:
    """Colours `[n, 3]` of any type as uint8 or uint16: real numbers up to 1 are shares of 255.

    Raises:
        BadFile: If they are neither shares nor whole numbers of 8 or 16 bits.
    """
    if values.dtype in (np.uint8, np.uint16):
        return values
    values = np.asarray(values, np.float64)
    if not np.isfinite(values).all() or (values < 0).any() or (values > 65535).any():
        raise BadFile("holds colours outside 0..65535")
    if (values <= 1).all() and (values % 1).any():
        return np.round(values * 255).astype(np.uint8)
    return np.round(values).astype(np.uint8 if (values <= 255).all() else np.uint16)


def as_uint8(color: np.ndarray) -> np.ndarray:
    """Colours for a format that has eight bits a channel."""
    return color if color.dtype == np.uint8 else (color >> 8).astype(np.uint8)


def as_uint16(color: np.ndarray) -> np.ndarray:
    """Colours for a format that has sixteen bits a channel; 255 becomes 65535."""
    return color if color.dtype == np.uint16 else color.astype(np.uint16) * 257
