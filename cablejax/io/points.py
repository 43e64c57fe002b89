"""Point files of every kind in, and four kinds out: units, large coordinates, invalid returns, colours, damage."""

import os
import warnings
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Num

from cablejax.io.columns import named_columns
from cablejax.io.raw import UNITS_MM, BadFile, RawCloud, join
from cablejax.io.sources import as_point_file_error, pieces

if TYPE_CHECKING:
    from cablejax.types import PointCloud

# Scanners mark a missing return with NaN, infinity, or the largest float; no cable is a light minute away.
LARGEST_MM = 1e15


@dataclass(frozen=True)
class PointFile:
    """A cloud as read, in millimetres.

    Attributes:
        xyz_mm: Coordinates `[n, 3]`, float64, mm, in the file's own frame.
        shift_mm: What `cloud` subtracts before it rounds to float32 `[3]`, whole mm near the median point.
        dropped: How many invalid returns were left out: NaN, infinite, or marked so by the format.
        color: Red, green, blue `[n, 3]`, uint8, or uint16 where the file has 16 bits a channel; or None.
        intensity: Reflected intensity `[n]`, float32, in the file's own scale, or None.
        unit: Unit that the file was taken to be in.
        path: Where it came from.
        stated_unit: Unit that the file itself states (E57, names of columns such as "x [m]"), or None.
    """

    xyz_mm: Float[np.ndarray, "n 3"]
    shift_mm: Float[np.ndarray, "3"]
    dropped: int
    color: Num[np.ndarray, "n 3"] | None
    intensity: Float[np.ndarray, " n"] | None
    unit: str
    path: Path
    stated_unit: str | None = None

    def cloud(self) -> "PointCloud":
        """The points less `shift_mm`, as float32: near zero float32 is exact to a fraction of a micrometre.

        Padded as `PointCloud.from_xyz` does by default.
        """
        from cablejax.types import PointCloud

        return PointCloud.from_xyz(self.xyz_mm - self.shift_mm)


def read_points(
    path: str | os.PathLike[str],
    *,
    unit: str | None = "mm",
    columns: str | Sequence[str] | None = None,
    time_limit_s: float | None = None,
) -> PointFile:
    """Read a point file: PLY, PCD, XYZ, TXT, CSV, PTS, PTX, OBJ, LAS, LAZ, COPC or E57, gzipped or not.

    The content decides, the ending only where the content is plain text. Formats that need native libraries are read
    in a process of their own.

    Args:
        path: The file.
        unit: The file's unit: "um", "mm", "cm", "dm", "m", "km", "in" or "ft"; None for the one that it states itself, as E57
            does and column names may ("x [m]"), and mm where it states none.
        columns: What the columns of a text table are, such as "index,x,y,z,intensity"; None for what its header says or
            its numbers leave no doubt about.
        time_limit_s: Most time that a native reader may take. None: 30 s and a second for every MB.

    Returns:
        The points in mm with colours, intensities and the number of invalid returns left out.

    Warns:
        UserWarning: What was odd but cost no coordinate: colours left out, a last point missing, another unit stated.

    Raises:
        ValueError: If `unit` or a name among `columns` is unknown.
        PointFileError: If there is no whole cloud to be had: path and reason in one sentence.

    Example:
        >>> import tempfile
        >>> with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
        ...     _ = file.write("x,y,z,intensity\\n1,2,3,10\\nnan,0,0,0\\n")
        ...     file.flush()
        ...     scan = read_points(file.name, unit="m")
        >>> scan.xyz_mm.tolist(), scan.dropped
        ([[1000.0, 2000.0, 3000.0]], 1)
    """
    _check_unit(unit)
    path, names = Path(path), None if columns is None else named_columns(columns)
    with as_point_file_error(path):
        raw = join(list(pieces(path, time_limit_s=time_limit_s, size=None, columns=names)))
        scan = in_millimetres(raw, path, unit)
        if len(scan.xyz_mm) == 0:
            raise BadFile(nothing_valid(scan.dropped))
    _warn(raw, path, unit)
    return scan


def iter_points(
    path: str | os.PathLike[str],
    *,
    unit: str | None = "mm",
    columns: str | Sequence[str] | None = None,
    chunk: int = 1_000_000,
    time_limit_s: float | None = None,
) -> Iterator[PointFile]:
    """Read a file in pieces, for clouds larger than memory.

    LAS, LAZ, COPC, E57 and binary PLY and PCD are never held whole; text, ASCII and compressed PCD are, and handed out
    in pieces. All pieces share one `shift_mm`. A piece may be smaller than `chunk`; an empty one is left out, its
    invalid returns are counted with the next, or with the one before at the end of the file.

    Args:
        path: The file.
        unit: Its unit, as for `read_points`.
        columns: What its columns are, as for `read_points`.
        chunk: Most points a piece.
        time_limit_s: Most time to wait for a native reader, all pieces together, as for `read_points`.

    Yields:
        The next points.

    Raises:
        ValueError: If `unit` or a name among `columns` is unknown, or `chunk` is below 1.
        PointFileError: As `read_points`; where only the end of a file is damaged, after the pieces before it.
    """
    if chunk < 1:
        raise ValueError(f"chunk: expected 1 or more, got {chunk}")
    _check_unit(unit)
    path, names = Path(path), None if columns is None else named_columns(columns)
    shift, before, dropped, said = None, None, 0, set()
    with as_point_file_error(path):
        for raw in pieces(path, time_limit_s=time_limit_s, size=chunk, columns=names):
            said |= _warn(raw, path, unit, said)
            piece = in_millimetres(raw, path, unit, shift)
            dropped += piece.dropped
            if len(piece.xyz_mm) == 0:
                continue
            if before is not None:
                yield before
            before, shift, dropped = replace(piece, dropped=dropped), piece.shift_mm, 0
        if before is None:
            raise BadFile(nothing_valid(dropped))
    yield replace(before, dropped=before.dropped + dropped)


def unit_scale(unit: str) -> float:
    """Millimetres in a unit.

    Raises:
        ValueError: If the unit is unknown.
    """
    if unit not in UNITS_MM:
        raise ValueError(f"unit: expected one of {', '.join(UNITS_MM)}, got {unit!r}")
    return UNITS_MM[unit]


def _check_unit(unit: str | None) -> None:
    if unit is not None:
        unit_scale(unit)


def _warn(raw: RawCloud, path: Path, unit: str | None, said: Collection[str] = ()) -> set[str]:
    """Say what was odd about a file, once; what was said."""
    notes = list(raw.notes)
    if None not in (raw.unit, unit) and raw.unit != unit:
        notes.append(f"it says itself that it is in {raw.unit}, and is read as {unit} as asked")
    for note in notes:
        if note not in said:
            warnings.warn(f"{path.name}: {note}", stacklevel=3)
    return {*notes}


def nothing_valid(dropped: int) -> str:
    """Why an empty cloud is an error."""
    return f"holds no valid point ({dropped:,} invalid returns)" if dropped else "holds no point"


def in_millimetres(
    raw: RawCloud, path: Path, unit: str | None, shift_mm: Float[np.ndarray, "3"] | None = None
) -> PointFile:
    """Scale to mm, leave out what is no point, choose the shift where none is given."""
    unit = unit or raw.unit or "mm"
    scale = unit_scale(unit)
    with np.errstate(over="ignore", invalid="ignore"):
        xyz_mm = raw.xyz * scale
        valid = (np.abs(xyz_mm) < LARGEST_MM).all(axis=1)
    if shift_mm is None:
        shift_mm = np.round(np.median(xyz_mm[valid], axis=0)) if valid.any() else np.zeros(3)
    return PointFile(
        xyz_mm=xyz_mm[valid],
        shift_mm=shift_mm,
        dropped=raw.dropped + int((~valid).sum()),
        color=None if raw.color is None else raw.color[valid],
        intensity=None if raw.intensity is None else raw.intensity[valid],
        unit=unit,
        path=path,
        stated_unit=raw.unit,
    )
