"""PLY, the Stanford polygon format: vertices of ASCII and binary files, parsed with NumPy alone."""

from typing import NamedTuple

import numpy as np

from cablejax.io.raw import BadFile, RawCloud, colored, one_short
from cablejax.io.records import RecordBlock, varying_records
from cablejax.io.rows import is_count, parse_rows, split_lines

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
COLOR_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
INTENSITY_NAMES = ("intensity", "scalar_intensity", "reflectance", "scalar_reflectance", "scalar")


class Field(NamedTuple):
    """A property: its name, its NumPy type, and for a list the type of its length, else None."""

    name: str
    kind: str
    length: str | None = None


class Element(NamedTuple):
    """An element of the header: "vertex", "face", ..., how many the file promises, and its properties."""

    name: str
    n: int
    fields: list[Field]

    def has_lists(self) -> bool:
        """Whether its records vary in size."""
        return any(field.length is not None for field in self.fields)


class Header(NamedTuple):
    """A parsed header: byte order (None for ASCII), elements in file order, length in bytes."""

    order: str | None
    elements: list[Element]
    size: int

    def vertex_index(self) -> int:
        """Where the vertices stand among the elements."""
        return next(i for i, element in enumerate(self.elements) if element.name == "vertex")


def parse_header(data: bytes) -> Header:
    """Parse the text before the data.

    Raises:
        BadFile: If it is no header, or describes no vertices with x, y and z.
    """
    end = data.find(b"end_header")
    size = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or size == 0:
        raise BadFile("is no PLY file: its header has no beginning or no end")
    order, elements = "", []
    for line in split_lines(data[:end].decode("latin-1"))[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                order = ORDERS[words[1]]
            elif words[0] == "element":
                elements.append(Element(words[1], int(words[2]), []))
            elif words[0] == "property":
                kinds = [TYPES[word] for word in words[2:4]] if words[1] == "list" else [TYPES[words[1]]]
                elements[-1].fields.append(Field(words[-1], kinds[-1], kinds[0] if len(kinds) > 1 else None))
            else:
                raise KeyError
        except (KeyError, IndexError, ValueError) as error:
            raise BadFile(f"has a PLY header line that means nothing: {line[:60]!r}") from error
    if order == "":
        raise BadFile("has a PLY header without a format line")
    header = Header(order, elements, size)
    _check_vertices(header)
    return header


def read_ply(data: bytes) -> RawCloud:
    """Read the vertices.

    Raises:
        BadFile: If the file holds fewer vertices than its header promises, or more.
    """
    header = parse_header(data)
    vertex = header.elements[header.vertex_index()]
    if header.order is None:
        columns, notes = _ascii_vertices(data, header)
    elif any(element.has_lists() for element in header.elements[: header.vertex_index() + 1]):
        columns, notes = _varying_vertices(data, header), ()
    else:
        rows, notes = _block(header).rows(data)
        columns = {name: rows[name] for name in rows.dtype.names or ()}
    real = {name for name, field in _scalars(vertex).items() if field.kind[0] == "f"}
    cloud = from_columns(columns, real)
    return cloud._replace(notes=(*notes, *cloud.notes))


def binary_block(head: bytes) -> RecordBlock | None:
    """Where the vertices of a binary file stand, from its beginning; None for ASCII, and where lists vary in length.

    Raises:
        BadFile: If that is no header.
    """
    header = parse_header(head)
    lists = any(element.has_lists() for element in header.elements[: header.vertex_index() + 1])
    return None if header.order is None or lists else _block(header)


def from_fields(rows: np.ndarray) -> RawCloud:
    """A cloud from a structured array with fields x, y, z and perhaps colours and intensity."""
    names = rows.dtype.names or ()
    return from_columns({name: rows[name] for name in names}, {name for name in names if rows.dtype[name].kind == "f"})


def from_columns(columns: dict[str, np.ndarray], real: set[str]) -> RawCloud:
    """A cloud from columns by name in small letters, of which `real` are declared as real numbers."""
    cloud = RawCloud(np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1))
    name = next((name for name in INTENSITY_NAMES if name in columns), None)
    if name is not None:
        cloud = cloud._replace(intensity=columns[name].astype(np.float32))
    triple = next((triple for triple in COLOR_NAMES if set(triple) <= columns.keys()), None)
    if triple is None:
        return cloud
    return colored(cloud, np.stack([columns[name] for name in triple], axis=1), shares=set(triple) <= real)


def _scalars(element: Element) -> dict[str, Field]:
    """The properties that are no lists, by name in small letters; of equal names the first counts."""
    return {field.name.lower(): field for field in reversed(element.fields) if field.length is None}


def _check_vertices(header: Header) -> None:
    """The vertex element must be there, once, with one x, y and z each."""
    vertices = [element for element in header.elements if element.name == "vertex"]
    if len(vertices) != 1:
        raise BadFile(f"has {len(vertices)} vertex elements in its PLY header, expected one")
    names = [field.name.lower() for field in vertices[0].fields]
    if any(names.count(axis) != 1 for axis in "xyz") or not {"x", "y", "z"} <= _scalars(vertices[0]).keys():
        raise BadFile(f"has vertices without one x, y and z each: {names[:8]}")
    if any(element.n < 0 for element in header.elements):
        raise BadFile("has a negative count in its PLY header")


def _record(order: str, fields: list[Field]) -> np.dtype:
    """The record of an element without lists; names in small letters, made different by their place where they are not."""
    names = [field.name.lower() for field in fields]
    unique = [name if name not in names[:i] else f"{name} {i}" for i, name in enumerate(names)]
    return np.dtype([(name, f"{order}{field.kind}") for name, field in zip(unique, fields, strict=True)])


def _block(header: Header) -> RecordBlock:
    at, order = header.vertex_index(), header.order or "="
    start = header.size + sum(e.n * _record(order, e.fields).itemsize for e in header.elements[:at])
    vertex = header.elements[at]
    return RecordBlock(_record(order, vertex.fields), vertex.n, start, at == len(header.elements) - 1)


def _varying_vertices(data: bytes, header: Header) -> dict[str, np.ndarray]:
    """The vertices of a binary file in which they, or what stands before them, have lists."""
    start, order = header.size, header.order or "="
    columns: dict[str, np.ndarray] = {}
    at = header.vertex_index()
    for element in header.elements[: at + 1]:
        fields = [
            (field.name.lower(), order + field.kind, field.length and order + field.length) for field in element.fields
        ]
        columns, start = varying_records(data, start, element.n, fields, what=element.name)
    if at == len(header.elements) - 1 and data[start:].strip(b"\0 \r\n\t"):
        raise BadFile(f"holds {len(data) - start:,} bytes more than the {header.elements[at].n:,} points of its header")
    return columns


def _ascii_vertices(data: bytes, header: Header) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    at = header.vertex_index()
    vertex = header.elements[at]
    text = data[header.size :].rstrip(b"\0\x1a").decode("latin-1")
    lines = [line for line in split_lines(text) if line.strip()]
    start = sum(element.n for element in header.elements[:at])
    block, notes = lines[start : start + vertex.n], ()
    if len(block) < vertex.n:
        notes = one_short(len(block), vertex.n, ended=text.endswith(("\n", "\r")))
    if at == len(header.elements) - 1 and len(lines) > start + vertex.n:
        raise BadFile(f"holds more lines than the {vertex.n:,} points of its header")
    if not block:
        return {field.name.lower(): np.zeros(0) for field in vertex.fields}, notes
    if vertex.has_lists():
        block = [_without_lists(line, vertex.fields) for line in block]
    fields = [field for field in vertex.fields if field.length is None]
    table = parse_rows(block, columns=len(fields))
    columns = {field.name.lower(): table[:, i] for i, field in reversed(list(enumerate(fields)))}
    for axis in "xyz":
        if (kind := _scalars(vertex)[axis].kind)[0] in "iu" and not _fits(columns[axis], np.dtype(kind)):
            raise BadFile(f"holds a {axis} that is no {kind} number")
    return columns, notes


def _without_lists(line: str, fields: list[Field]) -> str:
    """The numbers of a row that belong to no list."""
    words, kept, at = line.split(), [], 0
    for field in fields:
        if field.length is None:
            kept += words[at : at + 1]
            at += 1
        elif at < len(words) and is_count(words[at]):
            at += 1 + int(words[at])
        else:
            raise BadFile(f"is damaged: expected the length of the list {field.name} in {line[:40]!r}")
    if at != len(words):
        raise BadFile(f"is damaged: expected {at} numbers in a row, got {len(words)}: {line[:40]!r}")
    return " ".join(kept)


def _fits(column: np.ndarray, dtype: np.dtype) -> bool:
    """Whether every value of a column is a whole number that fits an integer type."""
    limits = np.iinfo(dtype)
    return bool(((column >= limits.min) & (column <= limits.max) & (column % 1 == 0)).all())
