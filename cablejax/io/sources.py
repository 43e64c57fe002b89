"""From a path to points in the file's unit: what the file is, and its pieces, large or small."""

import contextlib
import functools
import gzip
import os
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.io import pcd, ply
from cablejax.io.isolated import read_isolated
from cablejax.io.ptx import read_ptx
from cablejax.io.raw import BadFile, PointFileError, RawCloud, one_short
from cablejax.io.records import RecordBlock
from cablejax.io.text import read_obj, read_pts, read_table

PARSERS: dict[str, Callable[..., RawCloud]] = {
    ".ply": ply.read_ply, ".pcd": pcd.read_pcd, ".pts": read_pts, ".ptx": read_ptx, ".obj": read_obj,
    ".xyz": read_table, ".txt": read_table, ".csv": read_table, ".asc": read_table, ".dat": read_table,
}  # fmt: skip
TABLES = (".pts", ".xyz", ".txt", ".csv", ".asc", ".dat")
NATIVE = {".las": "las", ".laz": "las", ".e57": "e57"}
ENDINGS = (*PARSERS, *NATIVE)
GZIP_MAGIC = b"\x1f\x8b"
HEAD_BYTES = 2**16


def sniff(head: bytes, path: Path) -> str:
    """The format of a file, as an ending, from its first bytes and its name.

    Raises:
        BadFile: If neither tells.

    Example:
        >>> sniff(b"LASF...", Path("tree.txt"))
        '.las'
    """
    if head.startswith((b"ply\n", b"ply\r")):
        return ".ply"
    if head.startswith(b"LASF"):
        return ".las"
    if head.startswith(b"ASTM-E57"):
        return ".e57"
    if b"VERSION" in head[:4096] and b"FIELDS" in head[:4096]:
        return ".pcd"
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    if not suffixes or suffixes[-1] not in ENDINGS:
        raise BadFile(f"has an unknown ending; known are {', '.join(ENDINGS)}, each also with .gz")
    return suffixes[-1]


@contextlib.contextmanager
def as_point_file_error(path: Path) -> Iterator[None]:
    """Turn whatever reading a file can raise into a `PointFileError`."""
    try:
        yield
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


@contextlib.contextmanager
def open_source(path: Path) -> Iterator[tuple[Any, str, bool]]:
    """Open a file, unpacked where it is gzipped.

    Yields:
        The stream at its beginning, the format as an ending, and whether the file is gzipped.

    Raises:
        BadFile: If there is no regular file with a known content.
    """
    if path.is_dir():
        raise BadFile("is a folder, not a file")
    if path.exists() and not path.is_file():
        raise BadFile("is no regular file")
    with path.open("rb") as file:
        packed = file.read(2) == GZIP_MAGIC
        file.seek(0)
        stream = gzip.GzipFile(fileobj=file) if packed else file
        head = stream.read(HEAD_BYTES)
        if not head:
            raise BadFile("is empty")
        kind = sniff(head, path)
        stream.seek(0)
        yield stream, kind, packed


def pieces(
    path: Path, *, time_limit_s: float | None, size: int | None, columns: Sequence[str] | None = None
) -> Iterator[RawCloud]:
    """The points of a file, in pieces of `size` points, or as they come where it is None.

    LAS, LAZ, E57 and binary PLY and PCD are read piece by piece; the rest is read whole and handed out in pieces.

    Raises:
        BadFile, OSError, EOFError, zlib.error: As the formats' readers do.
    """
    with open_source(path) as (stream, kind, packed):
        if columns is not None and kind not in TABLES:
            raise BadFile(f"names its columns itself, being {kind[1:].upper()}; columns are for {', '.join(TABLES)}")
        if kind in PARSERS:
            rows = None if size is None else _records(stream, kind, None if packed else path.stat().st_size, size)
            if rows is None:
                stream.seek(0)
                parse = PARSERS[kind] if columns is None else functools.partial(PARSERS[kind], columns=columns)
                yield from _sliced(_quietly(parse, stream.read()), size)
            else:
                yield from rows
            return
        limit = 30 + path.stat().st_size / 1e6 if time_limit_s is None else time_limit_s
        with contextlib.ExitStack() as stack:
            source = stack.enter_context(_unpacked(stream, kind)) if packed or not _speakable(path) else path
            yield from read_isolated(NATIVE[kind], source, time_limit_s=limit, size=size)


def _speakable(path: Path) -> bool:
    """Whether a native library, which takes names as UTF-8, can be told this one."""
    try:
        os.fsencode(path).decode()
    except UnicodeDecodeError:
        return False
    return True


def _records(stream: Any, kind: str, length: int | None, size: int) -> Iterator[RawCloud] | None:
    """Binary PLY or PCD piece by piece; None for the other formats and for what is stored otherwise."""
    if kind not in (".ply", ".pcd"):
        return None
    head = stream.read(HEAD_BYTES)
    block = ply.binary_block(head) if kind == ".ply" else pcd.binary_block(head)
    if block is None:
        return None
    if length is not None:
        block.held(length)
    parse = ply.from_fields if kind == ".ply" else pcd.from_fields
    return _parsed(block, parse, stream, size)


def _parsed(block: RecordBlock, parse: Callable[[Any], RawCloud], stream: Any, size: int) -> Iterator[RawCloud]:
    """The pieces of a block; an empty one at the end says that its last point is missing."""
    read = 0
    for rows in block.read(stream, size):
        read += len(rows)
        yield _quietly(parse, rows)
    if read < block.n:
        yield RawCloud(np.zeros((0, 3)), notes=one_short(read, block.n))


def _quietly(parse: Callable[[Any], RawCloud], data: Any) -> RawCloud:
    """Parse without NumPy's warnings: numbers that overflow become infinities, which are dropped and counted later."""
    with np.errstate(over="ignore", invalid="ignore"):
        return parse(data)


def _sliced(raw: RawCloud, size: int | None) -> Iterator[RawCloud]:
    """A cloud in pieces; what was dropped is counted with the first."""
    size = size or max(len(raw.xyz), 1)
    for start in range(0, max(len(raw.xyz), 1), size):
        part = slice(start, start + size)
        color = None if raw.color is None else raw.color[part]
        intensity = None if raw.intensity is None else raw.intensity[part]
        first = raw._replace(dropped=0) if start else raw
        yield first._replace(xyz=raw.xyz[part], color=color, intensity=intensity)


@contextlib.contextmanager
def _unpacked(stream: Any, kind: str) -> Iterator[Path]:
    """A file's content, unpacked, in a file of its own, for readers that open files themselves."""
    with tempfile.TemporaryDirectory(prefix="cablejax-") as folder:
        path = Path(folder, f"unpacked{kind}")
        with path.open("wb") as file:
            while block := stream.read(2**20):
                file.write(block)
        yield path
