"""PCD, the Point Cloud Library's format: ASCII, binary and compressed, parsed with NumPy alone."""

from typing import NamedTuple

import numpy as np

from cablejax.io.ply import INTENSITY_NAMES
from cablejax.io.raw import BadFile, RawCloud, as_color
from cablejax.io.records import RecordBlock
from cablejax.io.text import parse_rows, split_lines

KINDS = {("F", 4): "<f4", ("F", 8): "<f8", ("I", 1): "i1", ("I", 2): "<i2", ("I", 4): "<i4", ("I", 8): "<i8",
         ("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8"}  # fmt: skip
STORAGES = ("ascii", "binary", "binary_compressed")
PADDING = "_"


class Header(NamedTuple):
    """A parsed header: one record's type, how many there are, how they are stored, length in bytes."""

    dtype: np.dtype
    n: int
    storage: str
    size: int


def parse_header(data: bytes) -> Header:
    """Parse the text before the data.

    Raises:
        BadFile: If it is no header, contradicts itself, or describes no x, y and z.
    """
    entries: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in entries:
        end = data.find(b"\n", at)
        if end < 0 or end > 65536:
            raise BadFile("is no PCD file: its header has no DATA line")
        words = data[at:end].decode("latin-1").split()
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        at = end + 1
    try:
        names = entries["FIELDS"] if "FIELDS" in entries else entries["COLUMNS"]
        sizes, kinds = map(int, entries["SIZE"]), entries["TYPE"]
        repeats = [int(word) for word in entries.get("COUNT", ["1"] * len(names))]
        cells = [KINDS[kind, size] for kind, size in zip(kinds, sizes, strict=True)]
        dtype = np.dtype(_unique_fields(names, cells, repeats))
        count = int(entries["POINTS"][0]) if "POINTS" in entries else _grid(entries)
        header = Header(dtype, count, entries["DATA"][0], at)
        grid = _grid(entries) if {"WIDTH", "HEIGHT"} <= entries.keys() else count
    except (KeyError, IndexError, ValueError, TypeError, OverflowError) as error:
        raise BadFile(f"has a damaged PCD header ({type(error).__name__}: {str(error)[:60]})") from error
    if header.n < 0 or grid != header.n:
        raise BadFile("has a damaged PCD header: WIDTH x HEIGHT is not POINTS")
    if header.storage not in STORAGES:
        raise BadFile(f"stores its data as {header.storage!r}, expected one of {', '.join(STORAGES)}")
    if not {"x", "y", "z"} <= set(names):
        raise BadFile(f"has no fields x, y and z: {names[:8]}")
    return header


def read_pcd(data: bytes) -> RawCloud:
    """Read the points; the viewpoint is left alone, as other readers do.

    Raises:
        BadFile: If the file holds fewer points than its header promises, or more.
    """
    header = parse_header(data)
    if header.storage == "binary":
        return from_fields(_block(header).rows(data))
    body = data[header.size :]
    return from_fields(_ascii(body, header) if header.storage == "ascii" else _compressed(body, header))


def binary_block(head: bytes) -> RecordBlock | None:
    """Where the points of an uncompressed binary file stand, from its beginning; None for the other ways of storing.

    Raises:
        BadFile: If that is no header.
    """
    header = parse_header(head)
    return _block(header) if header.storage == "binary" else None


def lzf_decompress(data: bytes, size: int) -> bytes:
    """Decompress LZF: runs of literals (control byte below 32) and back references.

    Raises:
        BadFile: If the data is damaged or does not give exactly `size` bytes.
    """
    out = bytearray()
    at = 0
    try:
        while at < len(data) and len(out) <= size:
            control = data[at]
            if control < 32:
                out += data[at + 1 : at + 2 + control]
                at += 2 + control
                continue
            length = control >> 5
            if length == 7:
                at += 1
                length += data[at]
            start = len(out) - ((control & 31) << 8) - data[at + 1] - 1
            at += 2
            length += 2
            if start < 0:
                raise BadFile("is damaged: its compressed data points before its beginning")
            piece = out[start : start + length]
            # A reference may run into what it is writing: the piece repeats.
            out += piece if len(piece) == length else (piece * (length // len(piece) + 1))[:length]
    except IndexError as error:
        raise BadFile("is truncated: its compressed data breaks off") from error
    if len(out) != size:
        raise BadFile(f"is damaged: its compressed data gives {len(out):,} bytes, not {size:,}")
    return bytes(out)


def _block(header: Header) -> RecordBlock:
    return RecordBlock(header.dtype, header.n, header.size, last=True)


def _grid(entries: dict[str, list[str]]) -> int:
    return int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])


def _unique_fields(names: list[str], cells: list[str], repeats: list[int]) -> list[tuple]:
    """NumPy fields; padding ("_") may come several times and gets names of its own."""
    fields = []
    for index, (name, cell, repeat) in enumerate(zip(names, cells, repeats, strict=True)):
        if repeat < 1 or repeat > 4096:
            raise ValueError(f"COUNT {repeat}")
        label = f"{PADDING}{index}" if name == PADDING else name
        fields.append((label, cell) if repeat == 1 else (label, cell, (repeat,)))
    return fields


def _ascii(data: bytes, header: Header) -> np.ndarray:
    lines = [line for line in split_lines(data.decode("latin-1")) if line.strip()]
    _check_count(len(lines), header.n)
    rows = np.zeros(header.n, header.dtype)
    if not lines:
        return rows
    widths = [int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ()]
    table = parse_rows(lines, columns=sum(widths))
    at = 0
    for name, width in zip(header.dtype.names or (), widths, strict=True):
        cell = table[:, at : at + width].reshape(rows[name].shape)
        kind = rows[name].dtype
        rows[name] = _packed_as_float(cell) if name in ("rgb", "rgba") and kind == np.float32 else _cast(cell, kind)
        at += width
    return rows


def _packed_as_float(cell: np.ndarray) -> np.ndarray:
    """Packed colours as text: the integer itself (PCL), or the float of the same bits, which is never a whole number."""
    whole = np.isfinite(cell) & (cell >= 1) & (cell < 2**32) & (cell % 1 == 0)
    integers = np.where(whole, cell, 0).astype(np.uint32)
    return np.where(whole, integers.view(np.float32), _cast(cell, np.dtype(np.float32)))


def _cast(cell: np.ndarray, kind: np.dtype) -> np.ndarray:
    """Text numbers as the field's type.

    Raises:
        BadFile: If an integer field holds something else.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        cast = cell.astype(kind)
    if kind.kind != "f" and not np.array_equal(cast, cell):
        raise BadFile(f"holds a number that does not fit its type {kind.name}")
    return cast


def _compressed(data: bytes, header: Header) -> np.ndarray:
    """Compressed data: two lengths, then all of the first field, all of the second, and so on."""
    size = header.n * header.dtype.itemsize
    packed, unpacked = (int.from_bytes(data[i : i + 4], "little") for i in (0, 4))
    if len(data) < 8 or len(data) - 8 < packed:
        raise BadFile(
            f"is truncated: its header promises {packed:,} compressed bytes, {max(0, len(data) - 8):,} are there"
        )
    if unpacked != size:
        raise BadFile(f"is damaged: {header.n:,} points take {size:,} bytes, its data says {unpacked:,}")
    content = lzf_decompress(data[8 : 8 + packed], size)
    rows, at = np.empty(header.n, header.dtype), 0
    for name in header.dtype.names or ():
        cell = rows[name]
        rows[name] = np.frombuffer(content, cell.dtype, cell.size, at).reshape(cell.shape)
        at += cell.nbytes
    return rows


def _check_count(held: int, promised: int) -> None:
    if held < promised:
        raise BadFile(f"is truncated: its header promises {promised:,} points, {held:,} are there")
    if held > promised:
        raise BadFile(f"holds {held:,} points, more than the {promised:,} of its header")


def from_fields(rows: np.ndarray) -> RawCloud:
    """A cloud from records with fields x, y, z and perhaps packed colours and intensity.

    Raises:
        BadFile: If x, y or z holds several numbers.
    """
    names = rows.dtype.names or ()
    if any(rows.dtype[axis].shape for axis in "xyz"):
        raise BadFile("has several numbers in one of its fields x, y and z")
    xyz = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)
    color = None
    for name in ("rgb", "rgba"):
        if color is None and name in names and rows.dtype[name].itemsize == 4 and not rows.dtype[name].shape:
            packed = np.ascontiguousarray(rows[name]).view(np.uint32)
            color = np.stack([(packed >> shift).astype(np.uint8) for shift in (16, 8, 0)], axis=1)
    if color is None and {"r", "g", "b"} <= set(names):
        color = as_color(np.stack([rows[c] for c in "rgb"], axis=1))
    found = [name for name in names if name.lower() in INTENSITY_NAMES and not rows.dtype[name].shape]
    return RawCloud(xyz, color, rows[found[0]].astype(np.float32) if found else None)
