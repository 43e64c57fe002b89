"""Clouds as text: tables of columns (XYZ, TXT, CSV), OBJ vertices, and the row parser that other formats share."""

import re
from collections.abc import Sequence

import numpy as np

from cablejax.io.raw import BadFile, RawCloud, as_color

COMMENTS = ("#", "//", "%")
NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.IGNORECASE)
COLUMN_NAMES = {
    "x": ("x", "easting"),
    "y": ("y", "northing"),
    "z": ("z", "height", "elevation"),
    "r": ("r", "red"),
    "g": ("g", "green"),
    "b": ("b", "blue"),
    "i": ("i", "intensity", "reflectance", "scalar_intensity"),
}


def read_table(data: bytes) -> RawCloud:
    """Read a table with or without a header row; the delimiter is found out.

    Without column names, the columns are x y z, then one of: intensity; red green blue; red green blue intensity;
    intensity red green blue. Other columns (normals, for instance) are left out.

    Raises:
        BadFile: If the text is no table of numbers, naming the row.
    """
    lines = text_lines(data)
    names, start = None, 0
    for start, line in enumerate(lines):  # noqa: B007 (used after the loop)
        stripped = line.strip()
        mark = next((mark for mark in COMMENTS if stripped.startswith(mark)), None)
        if stripped and mark is None:
            break
        words = split_row(stripped.lstrip("#/% "))
        names = column_indices(words) or names
    else:
        raise BadFile("holds no point, only blank lines or comments")
    first = split_row(lines[start])
    if not all(map(is_number, first)):
        names = column_indices(first)
        if names is None:
            raise BadFile(f"is no point cloud: line {start + 1} holds neither numbers nor column names x, y, z: "
                          f"{lines[start].strip()[:50]!r}")  # fmt: skip
        start += 1
    table = parse_rows(lines[start:], usecols=None if names is None else sorted(names.values()))
    if names is None:
        return assign_columns(table)
    order = {index: position for position, index in enumerate(sorted(names.values()))}
    return pick({name: order[index] for name, index in names.items()}, table)


def read_obj(data: bytes) -> RawCloud:
    """Read the vertices of a Wavefront OBJ file, with colours where they follow the coordinates.

    Raises:
        BadFile: If it holds no vertex line, or a bad one.
    """
    rows = [line.strip()[2:] for line in text_lines(data) if line.lstrip()[:2] in ("v ", "v\t")]
    if not rows:
        raise BadFile("holds no point: there is no vertex line ('v x y z')")
    table = parse_rows(rows)
    if table.shape[1] not in (3, 4, 6, 7):
        raise BadFile(f"has vertex lines of {table.shape[1]} numbers, expected 3, 4, 6 or 7")
    color = as_color(table[:, -3:]) if table.shape[1] >= 6 else None
    return RawCloud(table[:, :3], color)


def text_lines(data: bytes) -> list[str]:
    """Decode text; a cloud written with any ASCII-compatible encoding will do.

    Raises:
        BadFile: If the bytes are no text.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return split_lines(data.decode("utf-16", errors="replace"))
    if b"\0" in data:
        raise BadFile("is no text file: it holds binary data")
    return split_lines(data.removeprefix(b"\xef\xbb\xbf").decode("latin-1"))


def split_lines(text: str) -> list[str]:
    """Lines of text with any kind of line end.

    `str.splitlines` would also break at other control characters, among them a byte of letters such as the UTF-8 of Å.
    """
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def split_row(line: str) -> list[str]:
    """The cells of a row."""
    delimiter = delimiter_of(line)
    return [cell.strip().strip('"').strip() for cell in line.strip().rstrip(delimiter or "").split(delimiter)]


def delimiter_of(line: str) -> str | None:
    """Semicolon, comma or tab where the row holds one, None for blanks."""
    return next((mark for mark in (";", ",", "\t") if mark in line.strip()), None)


def is_number(cell: str) -> bool:
    """Whether a cell is a number; a decimal comma is one in a row of semicolons."""
    return NUMBER.fullmatch(cell.replace(",", ".", 1)) is not None


def column_indices(words: Sequence[str]) -> dict[str, int] | None:
    """Which columns a header row names, None unless x, y and z are among them."""
    lowered = [word.lower().strip("\"'[]() ") for word in words]
    found = {}
    for name, synonyms in COLUMN_NAMES.items():
        hits = [index for index, word in enumerate(lowered) if word in synonyms]
        if hits:
            found[name] = hits[0]
    return found if {"x", "y", "z"} <= found.keys() else None


def parse_rows(lines: Sequence[str], *, columns: int | None = None, usecols: Sequence[int] | None = None) -> np.ndarray:
    """Parse rows of numbers of equal length.

    Args:
        lines: The rows; blank ones and comments are skipped.
        columns: How many numbers a row must hold; any number from 3 on where it is None.
        usecols: Which columns to read.

    Returns:
        The numbers `[n, columns]`, float64.

    Raises:
        BadFile: If a cell is no number or a row is shorter or longer than the first, naming the row.
    """
    delimiter = next((delimiter_of(line) for line in lines if line.strip()), None)
    if delimiter == ";" and any("," in line for line in lines[:100]):
        lines = [line.replace(",", ".") for line in lines]
    if delimiter is not None:
        lines = [line.strip().rstrip(delimiter) for line in lines]
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if not lines:
        raise BadFile("holds no point")
    try:
        table = np.loadtxt(lines, delimiter=delimiter, comments=None, usecols=usecols, quotechar='"', ndmin=2)
    except (ValueError, IndexError, OverflowError) as error:
        raise BadFile(f"is damaged or no point cloud: {str(error).split(';')[0].rstrip('.')}") from error
    if table.shape[1] < 3 or table.shape[1] != (columns or table.shape[1]):
        raise BadFile(f"has {table.shape[1]} numbers a row, expected {columns or 'at least 3'}")
    return table


def assign_columns(table: np.ndarray, *, intensity_first: bool = False) -> RawCloud:
    """Decide what the columns after x y z mean, from their number and values."""
    rest = table[:, 3:]
    names = {"x": 0, "y": 1, "z": 2}
    if rest.shape[1] == 1:
        names |= {"i": 3}
    elif rest.shape[1] == 3 and _looks_like_color(rest):
        names |= {"r": 3, "g": 4, "b": 5}
    elif rest.shape[1] == 4 and not intensity_first and _looks_like_color(rest[:, :3]):
        names |= {"r": 3, "g": 4, "b": 5, "i": 6}
    elif rest.shape[1] == 4 and _looks_like_color(rest[:, 1:]):
        names |= {"i": 3, "r": 4, "g": 5, "b": 6}
    return pick(names, table)


def pick(names: dict[str, int], table: np.ndarray) -> RawCloud:
    """A cloud from the columns that have a meaning."""
    xyz = table[:, [names["x"], names["y"], names["z"]]]
    color = as_color(table[:, [names[c] for c in "rgb"]]) if {"r", "g", "b"} <= names.keys() else None
    intensity = table[:, names["i"]].astype(np.float32) if "i" in names else None
    return RawCloud(xyz, color, intensity)


def _looks_like_color(values: np.ndarray) -> bool:
    """Whole numbers from 0 to 255: normals are not."""
    return bool(((values >= 0) & (values <= 255) & (values % 1 == 0)).all())
