"""Write clouds as PLY, PCD, XYZ, TXT, CSV, LAS or LAZ, at once or piece by piece, whole or not at all."""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Num

from cablejax.io.atomic import atomic_write
from cablejax.io.points import unit_scale
from cablejax.io.raw import BadFile, PointFileError, RawCloud
from cablejax.io.sinks import CsvSink, LasSink, PcdSink, PlySink, TextSink, las_step

SINKS: dict[str, Callable[[BinaryIO, RawCloud], Any]] = {
    ".ply": PlySink, ".pcd": PcdSink, ".xyz": TextSink, ".txt": TextSink, ".csv": CsvSink,
}  # fmt: skip
COMPRESSED = {".las": False, ".laz": True}
WRITABLE = (*SINKS, *COMPRESSED)
DEFAULT_STEP_MM = 1e-3


class PointWriter:
    """Write a cloud larger than memory piece by piece; the file appears when the block ends without an error.

    Args:
        path: Its ending chooses the format: .ply, .pcd, .xyz, .txt, .csv, .las or .laz.
        unit: The unit of the numbers in the file, as for `read_points`.
        step_mm: Step of LAS and LAZ coordinates, which reach 2^31 steps from the middle of the first piece.

    Raises:
        ValueError: If `unit` is unknown or `step_mm` is not positive.
        PointFileError: If the ending is unknown.

    Example:
        >>> import tempfile
        >>> from cablejax.io import read_points
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with PointWriter(f"{folder}/a.ply") as writer:
        ...         writer.write(np.zeros((2, 3)))
        ...         writer.write(np.ones((1, 3)))
        ...     len(read_points(f"{folder}/a.ply").xyz_mm)
        3
    """

    def __init__(self, path: str | os.PathLike[str], *, unit: str = "mm", step_mm: float = DEFAULT_STEP_MM):
        self.path = Path(path)
        self.scale = unit_scale(unit)
        if not step_mm > 0:
            raise ValueError(f"step_mm: expected more than 0, got {step_mm}")
        self.step = step_mm / self.scale
        if self.path.suffix.lower() not in WRITABLE:
            raise PointFileError(self.path, f"has an ending that cannot be written; known are {', '.join(WRITABLE)}")
        self._atomic = atomic_write(self.path)
        self._file: BinaryIO | None = None
        self._sink: Any = None
        self._first: RawCloud | None = None

    def write(
        self,
        xyz_mm: Num[Any, "n 3"],
        *,
        color: Num[Any, "n 3"] | None = None,
        intensity: Num[Any, " n"] | None = None,
    ) -> None:
        """Write the next points.

        Args:
            xyz_mm: Coordinates `[n, 3]`, mm, finite, n at least 1.
            color: Red, green, blue `[n, 3]`, uint8 or uint16; in every piece or in none.
            intensity: `[n]`; in every piece or in none.

        Raises:
            ValueError: If the arrays are wrong, or differ in kind from the first piece's.
            PointFileError: If the file cannot be written.
        """
        if self._file is None:
            raise ValueError("writer: expected an open one: `with PointWriter(path) as writer:`")
        cloud = checked(xyz_mm, color, intensity, self.scale)
        with as_write_error(self.path):
            if self._first is None:
                self._first, self._sink = cloud, self._open_sink(self._file, cloud)
            elif kinds(cloud) != kinds(self._first):
                raise ValueError(f"piece: expected {kinds(self._first)} as in the first piece, got {kinds(cloud)}")
            self._sink.append(cloud)

    def _open_sink(self, file: BinaryIO, first: RawCloud) -> Any:
        ending = self.path.suffix.lower()
        if ending in SINKS:
            return SINKS[ending](file, first)
        return LasSink(file, first, compressed=COMPRESSED[ending], step=self.step)

    def __enter__(self) -> "PointWriter":
        with as_write_error(self.path):
            self._file = self._atomic.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file = None
        with as_write_error(self.path):
            try:
                if error is None:
                    self._finish()
            except BaseException as failure:
                self._atomic.__exit__(type(failure), failure, failure.__traceback__)
                raise
            self._atomic.__exit__(kind, error, trace)

    def _finish(self) -> None:
        if self._sink is None:
            raise ValueError("xyz_mm: expected at least one piece of points, got none")
        self._sink.finish()


def write_points(
    path: str | os.PathLike[str],
    xyz_mm: Num[Any, "n 3"],
    *,
    unit: str = "mm",
    color: Num[Any, "n 3"] | None = None,
    intensity: Num[Any, " n"] | None = None,
) -> None:
    """Write a cloud in one step; a killed or failed write leaves the old file.

    PLY and text hold float64 coordinates and give back the same numbers. LAS and LAZ hold multiples of a step of 1e-6
    units, or of the smallest power of ten that fits the cloud's extent into 32 bits. PCD holds float32, the only type
    that its usual readers take, and refuses a cloud so far from the origin that this would show.

    Args:
        path: Its ending chooses the format: .ply, .pcd, .xyz, .txt, .csv, .las or .laz.
        xyz_mm: Coordinates `[n, 3]`, mm, finite.
        unit: Unit of the numbers in the file, as for `read_points`.
        color: Red, green, blue `[n, 3]`, uint8 or uint16.
        intensity: `[n]`. LAS and LAZ hold whole numbers to 65535; others go into an extra dimension.

    Raises:
        ValueError: If the cloud is empty or holds NaN, the arrays differ in length, or `unit` or a type is wrong.
        PointFileError: If the ending is unknown or the file cannot be written; the old file is untouched.

    Example:
        >>> import tempfile
        >>> from cablejax.io import read_points
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_points(f"{folder}/a.ply", np.array([[0.0, 1.0, 0.1]]))
        ...     read_points(f"{folder}/a.ply").xyz_mm.tolist()
        [[0.0, 1.0, 0.1]]
    """
    scale = unit_scale(unit)
    cloud = checked(xyz_mm, color, intensity, scale)
    with PointWriter(path, unit=unit, step_mm=las_step(cloud.xyz) * scale) as writer:
        writer.write(xyz_mm, color=color, intensity=intensity)


def checked(xyz_mm: Any, color: Any, intensity: Any, scale: float) -> RawCloud:
    """The arrays as NumPy, coordinates in the file's unit.

    Raises:
        ValueError: If a shape or type is wrong, or a coordinate is not finite.
    """
    xyz = np.asarray(xyz_mm, np.float64) / scale
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) == 0:
        raise ValueError(f"xyz_mm: expected shape [n, 3] with n at least 1, got {list(xyz.shape)}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"xyz_mm: expected finite coordinates, got {(~np.isfinite(xyz)).any(1).sum()} rows with NaN")
    if color is not None:
        color = np.asarray(color)
        if color.shape != xyz.shape or color.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"color: expected uint8 or uint16 {list(xyz.shape)}, got {color.dtype} {list(color.shape)}"
            )
    if intensity is not None:
        intensity = np.asarray(intensity, np.float32)
        if intensity.shape != xyz.shape[:1]:
            raise ValueError(f"intensity: expected shape [{len(xyz)}], got {list(intensity.shape)}")
    return RawCloud(xyz, color, intensity)


def kinds(cloud: RawCloud) -> str:
    """What a piece holds beside coordinates, in words."""
    color = "no color" if cloud.color is None else f"{cloud.color.dtype} color"
    return f"{color} and {'no ' if cloud.intensity is None else ''}intensity"


@contextlib.contextmanager
def as_write_error(path: Path) -> Iterator[None]:
    """Turn what writing can raise into a `PointFileError`."""
    try:
        yield
    except BadFile as error:
        raise PointFileError(path, str(error)) from error
    except OSError as error:
        raise PointFileError(path, f"cannot be written ({error.strerror or error})") from error
