"""PCD, the Point Cloud Library's format: ASCII, binary and compressed, parsed with NumPy alone."""

from typing import NamedTuple

import numpy as np

from cablejax.io.ply import INTENSITY_NAMES
from cablejax.io.raw import BadFile, RawCloud, colored, one_short
from cablejax.io.records import RecordBlock
from cablejax.io.rows import parse_rows, split_lines

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
            entries[words[0].upper()] = words[1:]
        at = end + 1
    try:
        names = entries["FIELDS"] if "FIELDS" in entries else entries["COLUMNS"]
        sizes, kinds = map(int, entries["SIZE"]), entries["TYPE"]
        repeats = [int(word) for word in entries.get("COUNT", ["1"] * len(names))]
        cells = [KINDS.get((kind.upper(), size), f"V{size}") for kind, size in zip(kinds, sizes, strict=True)]
        fields = _unique_fields(names, cells, repeats)
        if any(cell[0] == "V" for name, cell, *_ in fields if not name.startswith(PADDING)):
            raise ValueError("a field that is neither I, U nor F of 1, 2, 4 or 8 bytes")
        dtype = np.dtype(fields)
        count = int(entries["POINTS"][0]) if "POINTS" in entries else _grid(entries)
        header = Header(dtype, count, entries["DATA"][0].lower(), at)
        grid = _grid(entries) if {"WIDTH", "HEIGHT"} <= entries.keys() else count
    except (KeyError, IndexError, ValueError, TypeError, OverflowError) as error:
        raise BadFile(f"has a damaged PCD header ({type(error).__name__}: {str(error)[:60]})") from error
    if header.n < 0 or grid != header.n:
        raise BadFile("has a damaged PCD header: WIDTH x HEIGHT is not POINTS")
    if header.storage not in STORAGES:
        raise BadFile(f"stores its data as {header.storage!r}, expected one of {', '.join(STORAGES)}")
    if not {"x", "y", "z"} <= {field[0] for field in fields}:
        raise BadFile(f"has no fields x, y and z: {names[:8]}")
    return header


def read_pcd(data: bytes) -> RawCloud:
    """Read the points; the viewpoint is left alone, as other readers do.

    Raises:
        BadFile: If the file holds fewer points than its header promises, or more.
    """
    header = parse_header(data)
    body = data[header.size :]
    if header.storage == "ascii":
        columns, notes = _ascii(body, header)
        cloud = from_columns(columns, header.dtype)
    else:
        rows, notes = _block(header).rows(data) if header.storage == "binary" else (_compressed(body, header), ())
        cloud = from_fields(rows)
    return cloud._replace(notes=(*notes, *cloud.notes))


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
    """NumPy fields with names in small letters, without empty ones; padding and further equal names get their own."""
    fields, seen = [], {PADDING}
    for index, (name, cell, repeat) in enumerate(zip(names, cells, repeats, strict=True)):
        if repeat < 0 or repeat > 4096:
            raise ValueError(f"COUNT {repeat}")
        if repeat == 0:
            continue
        label = f"{PADDING}{index}" if name.lower() in seen else name.lower()
        seen.add(label)
        fields.append((label, cell) if repeat == 1 else (label, cell, (repeat,)))
    return fields


def _ascii(data: bytes, header: Header) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The columns of text, as real numbers, and what is to be said of them."""
    text = data.rstrip(b"\0\x1a").decode("latin-1")
    lines = [line for line in split_lines(text) if line.strip()]
    if len(lines) > header.n:
        raise BadFile(f"holds {len(lines):,} points, more than the {header.n:,} of its header")
    notes = one_short(len(lines), header.n, ended=text.endswith(("\n", "\r"))) if len(lines) < header.n else ()
    widths = [int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ()]
    table = parse_rows(lines, columns=sum(widths)) if lines else np.zeros((0, sum(widths)))
    columns, at = {}, 0
    for name, width in zip(header.dtype.names or (), widths, strict=True):
        columns[name] = table[:, at] if header.dtype[name].shape == () else table[:, at : at + width]
        at += width
    for axis in "xyz":
        _check_type(columns[axis], header.dtype[axis], axis)
    return columns, notes


def _check_type(column: np.ndarray, kind: np.dtype, name: str) -> None:
    """Refuse a coordinate that does not fit the integer type that the header gives it."""
    if kind.kind in "iu":
        limits = np.iinfo(kind)
        if not ((column >= limits.min) & (column <= limits.max) & (column % 1 == 0)).all():
            raise BadFile(f"holds a {name} that does not fit its type {kind.name}")


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


def from_fields(rows: np.ndarray) -> RawCloud:
    """A cloud from records with fields x, y, z and perhaps colours and intensity.

    Raises:
        BadFile: If x, y or z holds several numbers.
    """
    return from_columns({name: rows[name] for name in rows.dtype.names or ()}, rows.dtype)


def from_columns(columns: dict[str, np.ndarray], dtype: np.dtype) -> RawCloud:
    """A cloud from columns `[n]`, binary ones of the type that the header gives, or text ones of real numbers.

    Raises:
        BadFile: If x, y or z holds several numbers.
    """
    if any(columns[axis].ndim > 1 for axis in "xyz"):
        raise BadFile("has several numbers in one of its fields x, y and z")
    flat = {name: column for name, column in columns.items() if column.ndim == 1}
    cloud = RawCloud(np.stack([flat[axis].astype(np.float64) for axis in "xyz"], axis=1))
    name = next((name for name in flat if name in INTENSITY_NAMES), None)
    if name is not None:
        cloud = cloud._replace(intensity=flat[name].astype(np.float32))
    name = next((name for name in ("rgb", "rgba") if name in flat and dtype[name].itemsize == 4), None)
    if name is not None:
        return _packed_color(cloud, flat[name], dtype[name])
    if set("rgb") <= flat.keys():
        real = all(dtype[c].kind == "f" for c in "rgb")
        return colored(cloud, np.stack([flat[c] for c in "rgb"], axis=1), shares=real)
    return cloud


def _packed_color(cloud: RawCloud, column: np.ndarray, kind: np.dtype) -> RawCloud:
    """Colours from four bytes 0, red, green, blue, as an integer or as the float of the same bits.

    Text of a float field holds that float, which is never a whole number, or the integer itself (PCL).
    """
    if column.dtype.itemsize == 4:
        packed = np.ascontiguousarray(column).view(np.uint32)
    else:
        valid = np.isfinite(cloud.xyz).all(axis=1)
        least = 0 if kind.kind == "u" else -(2**31)  # a signed field holds alpha's highest bit as a sign
        whole = (column % 1 == 0) & (column >= least) & (column < 2**32)
        if kind.kind == "f":
            whole &= (column >= 1) | (column == 0)
        elif not whole[valid].all():
            return cloud._replace(notes=(*cloud.notes, "its colours are left out: some are no packed 32-bit numbers"))
        if kind.kind == "f" and not np.isfinite(column[valid]).all():
            return cloud._replace(notes=(*cloud.notes, "its colours are left out: some are NaN"))
        integers = np.where(whole, column, 0).astype(np.int64).astype(np.uint32)
        packed = np.where(whole, integers, column.astype(np.float32).view(np.uint32))
    return cloud._replace(color=np.stack([(packed >> shift).astype(np.uint8) for shift in (16, 8, 0)], axis=1))
