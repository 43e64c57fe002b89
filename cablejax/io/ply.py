"""PLY, the Stanford polygon format: vertices of ASCII and binary files, parsed with NumPy alone."""

from typing import NamedTuple

import numpy as np

from cablejax.io.raw import BadFile, RawCloud, as_color
from cablejax.io.records import RecordBlock
from cablejax.io.text import parse_rows, split_lines

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
COLOR_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
INTENSITY_NAMES = ("intensity", "scalar_intensity", "reflectance", "scalar_reflectance", "scalar")


class Element(NamedTuple):
    """An element of the header.

    Attributes:
        name: "vertex", "face", ...
        n: How many the file promises.
        fields: Name and NumPy type of each property; the type is None for a list.
    """

    name: str
    n: int
    fields: list[tuple[str, str | None]]


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
                elements[-1].fields.append((words[-1], None if words[1] == "list" else TYPES[words[1]]))
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
    rows = _ascii_vertices(data, header) if header.order is None else _block(header).rows(data)
    return from_fields(rows)


def binary_block(head: bytes) -> RecordBlock | None:
    """Where the vertices of a binary file stand, from its beginning; None for ASCII.

    Raises:
        BadFile: If that is no header.
    """
    header = parse_header(head)
    return None if header.order is None else _block(header)


def vertex_dtype(header: Header) -> np.dtype:
    """The record of one vertex."""
    vertex = header.elements[header.vertex_index()]
    return np.dtype([(name, f"{header.order or '='}{kind}") for name, kind in vertex.fields])


def from_fields(rows: np.ndarray) -> RawCloud:
    """A cloud from a structured array with fields x, y, z and perhaps colours and intensity."""
    names = {name.lower(): name for name in rows.dtype.names or ()}
    xyz = np.stack([rows[names[axis]].astype(np.float64) for axis in "xyz"], axis=1)
    color = intensity = None
    for triple in COLOR_NAMES:
        if color is None and all(name in names for name in triple):
            color = as_color(np.stack([rows[names[name]] for name in triple], axis=1))
    for name in INTENSITY_NAMES:
        if intensity is None and name in names:
            intensity = rows[names[name]].astype(np.float32)
    return RawCloud(xyz, color, intensity)


def _check_vertices(header: Header) -> None:
    """The vertex element must be there, once, with scalar properties of different names."""
    vertices = [element for element in header.elements if element.name == "vertex"]
    if len(vertices) != 1:
        raise BadFile(f"has {len(vertices)} vertex elements in its PLY header, expected one")
    names = [name.lower() for name, _ in vertices[0].fields]
    if not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        raise BadFile(f"has vertices without one x, y and z each: {names[:8]}")
    if any(kind is None for _, kind in vertices[0].fields):
        raise BadFile("has vertices with a list property, which is not supported")
    if any(element.n < 0 for element in header.elements):
        raise BadFile("has a negative count in its PLY header")


def _block(header: Header) -> RecordBlock:
    at = header.vertex_index()
    start = header.size + sum(_fixed_size(element) for element in header.elements[:at])
    return RecordBlock(vertex_dtype(header), header.elements[at].n, start, at == len(header.elements) - 1)


def _fixed_size(element: Element) -> int:
    """Bytes of an element without lists."""
    if any(kind is None for _, kind in element.fields):
        raise BadFile(f"has a list element ({element.name}) before its vertices, which is not supported")
    return element.n * sum(np.dtype(kind).itemsize for _, kind in element.fields)


def _ascii_vertices(data: bytes, header: Header) -> np.ndarray:
    at = header.vertex_index()
    vertex, dtype = header.elements[at], vertex_dtype(header)
    lines = [line for line in split_lines(data[header.size :].decode("latin-1")) if line.strip()]
    start = sum(element.n for element in header.elements[:at])
    block = lines[start : start + vertex.n]
    if len(block) < vertex.n:
        raise BadFile(f"is truncated: its header promises {vertex.n:,} points, {len(block):,} are there")
    if at == len(header.elements) - 1 and len(lines) > start + vertex.n:
        raise BadFile(f"holds more lines than the {vertex.n:,} points of its header")
    table = parse_rows(block, columns=len(vertex.fields))
    rows = np.empty(vertex.n, dtype)
    for index, (name, kind) in enumerate(vertex.fields):
        column = table[:, index]
        if np.dtype(kind).kind in "iu" and not _fits(column, np.dtype(kind)):
            raise BadFile(f"holds a {name} that is no {kind} number")
        rows[name] = column
    return rows


def _fits(column: np.ndarray, dtype: np.dtype) -> bool:
    """Whether every value of a column can be stored in an integer type."""
    limits = np.iinfo(dtype)
    return bool(((column >= limits.min) & (column <= limits.max)).all())
