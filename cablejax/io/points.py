"""Point files of every kind in, and four kinds out: units, large coordinates, invalid returns, colours, damage."""

import gzip
import os
import tempfile
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Num

from cablejax.io.isolated import read_isolated
from cablejax.io.leica import read_pts, read_ptx
from cablejax.io.pcd import read_pcd
from cablejax.io.ply import read_ply
from cablejax.io.raw import BadFile, PointFileError, RawCloud
from cablejax.io.text import read_obj, read_table
from cablejax.types import PointCloud

UNITS_MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "km": 1e6, "in": 25.4, "ft": 304.8}
PARSERS: dict[str, Callable[[bytes], RawCloud]] = {
    ".ply": read_ply, ".pcd": read_pcd, ".pts": read_pts, ".ptx": read_ptx, ".obj": read_obj,
    ".xyz": read_table, ".txt": read_table, ".csv": read_table, ".asc": read_table, ".dat": read_table,
}  # fmt: skip
NATIVE = {".las": "las", ".laz": "las", ".e57": "e57"}
ENDINGS = (*PARSERS, *NATIVE)
GZIP_MAGIC = b"\x1f\x8b"
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
    """

    xyz_mm: Float[np.ndarray, "n 3"]
    shift_mm: Float[np.ndarray, "3"]
    dropped: int
    color: Num[np.ndarray, "n 3"] | None
    intensity: Float[np.ndarray, " n"] | None
    unit: str
    path: Path

    def cloud(self) -> PointCloud:
        """The points less `shift_mm`, as float32: near zero float32 is exact to a fraction of a micrometre."""
        return PointCloud.from_xyz(self.xyz_mm - self.shift_mm)


def read_points(path: str | os.PathLike[str], *, unit: str = "mm", time_limit_s: float | None = None) -> PointFile:
    """Read a point file: PLY, PCD, XYZ, TXT, CSV, PTS, PTX, OBJ, LAS, LAZ, COPC or E57, gzipped or not.

    The content decides, the ending only where the content is plain text. Formats that need native libraries are read
    in a process of their own.

    Args:
        path: The file.
        unit: The file's unit: "um", "mm", "cm", "dm", "m", "km", "in" or "ft". E57 is in metres by its standard.
        time_limit_s: Most time that a native reader may take. None: 30 s and a second for every MB.

    Returns:
        The points in mm with colours, intensities and the number of invalid returns left out.

    Raises:
        ValueError: If `unit` is unknown.
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
    scale = unit_scale(unit)
    path = Path(path)
    try:
        raw = _read(path, time_limit_s, unit)
        return _finish(raw, path, unit, scale)
    except BadFile as error:
        raise PointFileError(path, str(error)) from error
    except FileNotFoundError:
        raise PointFileError(path, "does not exist") from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise PointFileError(path, f"is damaged or truncated (its gzip stream is broken: {error})") from error
    except OSError as error:
        raise PointFileError(path, f"cannot be read ({error.strerror or error})") from error
    except (MemoryError, OverflowError) as error:
        raise PointFileError(path, "is damaged, or larger than this machine's memory") from error


def unit_scale(unit: str) -> float:
    """Millimetres in a unit.

    Raises:
        ValueError: If the unit is unknown.
    """
    if unit not in UNITS_MM:
        raise ValueError(f"unit: expected one of {', '.join(UNITS_MM)}, got {unit!r}")
    return UNITS_MM[unit]


def sniff(head: bytes, path: Path) -> str:
    """The format of a file, as an ending, from its first bytes and its name.

    Raises:
        BadFile: If neither tells.
    """
    if head.startswith((b"ply\n", b"ply\r")):
        return ".ply"
    if head.startswith(b"LASF"):
        return ".las"
    if head.startswith(b"ASTM-E57"):
        return ".e57"
    if b"VERSION" in head and b"FIELDS" in head:
        return ".pcd"
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    if not suffixes or suffixes[-1] not in ENDINGS:
        raise BadFile(f"has an unknown ending; known are {', '.join(ENDINGS)}, each also with .gz")
    return suffixes[-1]


def _read(path: Path, time_limit_s: float | None, unit: str) -> RawCloud:
    if path.is_dir():
        raise BadFile("is a folder, not a file")
    if path.exists() and not path.is_file():
        raise BadFile("is no regular file")
    with path.open("rb") as file:
        packed = file.read(2) == GZIP_MAGIC
        file.seek(0)
        stream = gzip.GzipFile(fileobj=file) if packed else file
        head = stream.read(4096)
        if not head:
            raise BadFile("is empty")
        kind = sniff(head, path)
        stream.seek(0)
        if kind in PARSERS:
            return PARSERS[kind](stream.read())
        if kind == ".e57" and unit != "m":
            warnings.warn(f"{path.name}: E57 files are in metres, read as {unit} as asked", stacklevel=3)
        limit = 30 + path.stat().st_size / 1e6 if time_limit_s is None else time_limit_s
        if not packed:
            return read_isolated(NATIVE[kind], path, time_limit_s=limit)
        with tempfile.NamedTemporaryFile(suffix=kind) as unpacked:
            while block := stream.read(2**20):
                unpacked.write(block)
            unpacked.flush()
            return read_isolated(NATIVE[kind], Path(unpacked.name), time_limit_s=limit)


def _finish(raw: RawCloud, path: Path, unit: str, scale: float) -> PointFile:
    """Scale to mm, leave out what is no point, choose the shift."""
    if len(raw.xyz) == 0:
        raise BadFile(f"holds no valid point ({raw.dropped:,} invalid returns)" if raw.dropped else "holds no point")
    with np.errstate(over="ignore", invalid="ignore"):
        xyz_mm = raw.xyz * scale
        valid = (np.abs(xyz_mm) < LARGEST_MM).all(axis=1)
    xyz_mm = xyz_mm[valid]
    dropped = raw.dropped + int((~valid).sum())
    if len(xyz_mm) == 0:
        raise BadFile(f"holds no valid point ({dropped:,} invalid returns)")
    return PointFile(
        xyz_mm=xyz_mm,
        shift_mm=np.round(np.median(xyz_mm, axis=0)),
        dropped=dropped,
        color=None if raw.color is None else raw.color[valid],
        intensity=None if raw.intensity is None else raw.intensity[valid],
        unit=unit,
        path=path,
    )
