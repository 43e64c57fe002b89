"""What every reader hands back, in the file's own unit, and the one error that every reader raises."""

import os
from typing import NamedTuple

import numpy as np

UNITS_MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "km": 1e6, "in": 25.4, "ft": 304.8}
LARGEST_DISTORTION = 1e-3  # a pose is written with four digits or more
SHARE_SLACK = 1e-3  # by so much rounding may carry a colour's share beyond 0 or 1


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
        notes: What was odd but cost no coordinate, in clauses to stand after the path: colours left out, say.
        unit: Unit that the file itself states, or None.
        row: Place of each point in the file `[n]`, where a part of it was read; None for all, in their order.
    """

    xyz: np.ndarray
    color: np.ndarray | None = None
    intensity: np.ndarray | None = None
    dropped: int = 0
    notes: tuple[str, ...] = ()
    unit: str | None = None
    row: np.ndarray | None = None


def truncated(held: int, promised: int, what: str = "its header") -> BadFile:
    """The error for a file that ends too soon."""
    return BadFile(f"is truncated: {what} promises {promised:,} points, {held:,} are there")


def one_short(held: int, promised: int, *, what: str = "its header", ended: bool = True) -> tuple[str, ...]:
    """What to say of a file that lacks its last point alone: some writers count one too many.

    Args:
        held: Points that are there.
        promised: Points that should be there.
        what: Who promises them.
        ended: Whether the last one there is whole for certain: in text, a line end follows it.

    Raises:
        BadFile: If it lacks more, or breaks off, which only a truncated file does.
    """
    if held < max(promised - 1, 1) or not ended:
        raise truncated(held, promised, what)
    return (f"{what} promises {promised:,} points, {held:,} are there and were read",)


def check_rotation(rotation: np.ndarray) -> None:
    """Make sure that a scan's pose turns it and does nothing else.

    Raises:
        BadFile: If the matrix `[3, 3]` is not orthonormal, or mirrors.
    """
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off < LARGEST_DISTORTION or np.linalg.det(rotation) < 0:
        how = "mirrors" if off < LARGEST_DISTORTION else f"is off a rotation by {off:.2g}"
        raise BadFile(f"has a scan whose pose {how}, so that its points cannot be placed")


def join(clouds: list[RawCloud]) -> RawCloud:
    """Several scans or pieces of one file as one cloud; colours and intensity stay where every one has them."""
    dropped = sum(cloud.dropped for cloud in clouds)
    notes = tuple(dict.fromkeys(note for cloud in clouds for note in cloud.notes))
    filled = [cloud for cloud in clouds if len(cloud.xyz)]
    if len(filled) < 2:
        return (filled[0] if filled else RawCloud(np.zeros((0, 3))))._replace(dropped=dropped, notes=notes)
    color = intensity = None
    if all(cloud.color is not None for cloud in filled):
        colors = [cloud.color for cloud in filled if cloud.color is not None]
        wide = len({part.dtype for part in colors}) > 1
        color = np.concatenate([as_uint16(part) if wide else part for part in colors])
    if all(cloud.intensity is not None for cloud in filled):
        intensity = np.concatenate([cloud.intensity for cloud in filled if cloud.intensity is not None])
    return RawCloud(
        xyz=np.concatenate([cloud.xyz for cloud in filled]),
        color=color,
        intensity=intensity,
        dropped=dropped,
        notes=notes,
        unit=filled[0].unit,
    )


def colored(cloud: RawCloud, values: np.ndarray, *, shares: bool = False) -> RawCloud:
    """The cloud with colours `[n, 3]` of any type; bad ones are left out with a note and never cost a coordinate.

    Args:
        cloud: Points; colours of those that are not finite do not matter.
        values: uint8 and uint16 are kept. Numbers up to 1 are shares of 255 where some are no whole numbers.
        shares: Whether whole numbers up to 1 are shares too, because the file declares real numbers.
    """
    if values.dtype in (np.uint8, np.uint16):
        return cloud._replace(color=values)
    valid = np.isfinite(cloud.xyz).all(axis=1, keepdims=True)
    values = np.where(valid, np.asarray(values, np.float64), 0.0)
    if not ((values >= -SHARE_SLACK) & (values <= 65535)).all():
        return cloud._replace(notes=(*cloud.notes, "its colours are left out: they hold numbers outside 0 to 65535"))
    if (values <= 1 + SHARE_SLACK).all() and (shares or bool((values % 1).any())):
        return cloud._replace(color=np.round(np.clip(values, 0, 1) * 255).astype(np.uint8))
    values = np.round(np.maximum(values, 0))
    return cloud._replace(color=values.astype(np.uint8 if (values <= 255).all() else np.uint16))


def as_uint8(color: np.ndarray) -> np.ndarray:
    """Colours for a format that has eight bits a channel."""
    return color if color.dtype == np.uint8 else (color >> 8).astype(np.uint8)


def as_uint16(color: np.ndarray) -> np.ndarray:
    """Colours for a format that has sixteen bits a channel; 255 becomes 65535."""
    return color if color.dtype == np.uint16 else color.astype(np.uint16) * 257
