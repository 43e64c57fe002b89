"""Clouds as text: tables of columns (XYZ, TXT, CSV, PTS), OBJ vertices, and the row parser that other formats share."""

import csv
import re
from collections.abc import Sequence

import numpy as np

from cablejax.io.columns import HOW, assign_columns, column_names, pick
from cablejax.io.raw import BadFile, RawCloud, colored, join, one_short

COMMENTS = ("#", "//", "%")
BLANK = " \r\n"
NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"[+-]?(\d+|\d*,\d+)(e[+-]?\d+)?", re.IGNORECASE)
TRAILING_COMMENT = re.compile(r"\s(#|//|%).*$")
# What the C library of Microsoft prints: 1.#QNAN, -1.#IND00, 1.#INF, -nan(ind), nan(snan).
MICROSOFT = re.compile(r"[+-]?\d\.#(QNAN|SNAN|IND|INF|J)\w*|[+-]?nan\((ind|snan)\)", re.IGNORECASE)
MISSING = ("", '""', "na", "n/a", "null", "none", "-")


def read_table(data: bytes, columns: Sequence[str] | None = None, *, intensity_first: bool = False) -> RawCloud:
    """Read a table, with or without a row of names, and with or without counts; the delimiter is found out.

    Names come from a header row, also in a comment. Without them the columns are x y z, then what `assign_columns` tells.
    A row that holds one whole number says how many rows follow (PTS), as often as it likes.

    Args:
        data: The file.
        columns: What each column means, from `named_columns`; a row of names is then not asked.
        intensity_first: Whether intensity stands before colours where there are no names.

    Raises:
        BadFile: If the text is no table of numbers, naming the row, or its first columns look like an index.
    """
    every = text_lines(data)
    lines = [line for line in every if line.strip(BLANK)]
    rows = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    if not rows:
        raise BadFile("holds no point, only blank lines or comments")
    first = next((i for i, line in enumerate(lines) if line is rows[0]), 0)
    comments = [line for line in lines[: first + 3] if line.lstrip().startswith(COMMENTS)]
    header = None
    for place in (0, 1):  # before the first count, or behind it
        if header is None and place < len(rows) and not _is_data(rows[place]) and (place == 0 or _is_count(rows[0])):
            header = rows.pop(place)
    if not rows:
        raise BadFile("holds no point")
    blocks, notes = _blocks(rows, ended=not every[-1].strip(BLANK)) if _is_count(rows[0]) else ([rows], ())
    where = "" if header is None else f"line {every.index(header) + 1}"
    clouds = [_read_block(block, header, where, comments, columns, intensity_first) for block in blocks]
    return join([*clouds, RawCloud(np.zeros((0, 3)), notes=notes)])


def read_pts(data: bytes, columns: Sequence[str] | None = None) -> RawCloud:
    """Read PTS: blocks of a count and as many rows `x y z [intensity [r g b]]`, or such rows without a count.

    Raises:
        BadFile: If a block is shorter or longer than its count.
    """
    return read_table(data, columns, intensity_first=True)


def read_obj(data: bytes) -> RawCloud:
    """Read the vertices of a Wavefront OBJ file, with colours where they follow the coordinates.

    Raises:
        BadFile: If it holds no vertex line, or a bad one.
    """
    rows = [line.strip()[2:] for line in text_lines(data) if line.lstrip()[:2] in ("v ", "v\t")]
    if not rows:
        raise BadFile("holds no point: there is no vertex line ('v x y z')")
    table = parse_rows(rows)
    width = table.shape[1]
    if width not in (3, 4, 6, 7):
        raise BadFile(f"has vertex lines of {width} numbers, expected 3, 4, 6 or 7")
    cloud = RawCloud(table[:, :3])
    if width < 6:
        return cloud
    if width == 6:
        return colored(cloud, table[:, 3:], shares=True)
    ones = (table[:, [3, 6]] == 1).all(axis=0)  # a weight before the colours, or their alpha behind them
    if ones[0] == ones[1]:
        return cloud._replace(
            notes=("its colours are left out: four numbers stand behind x, y and z, none or two all 1",)
        )
    return colored(cloud, table[:, 4:] if ones[0] else table[:, 3:6], shares=True)


def _read_block(
    rows: list[str], header: str | None, where: str, comments: list[str], columns: Sequence[str] | None, i_first: bool
) -> RawCloud:
    """The points of rows that belong together."""
    if columns is not None:
        places = {name: index for index, name in enumerate(columns) if name}
        table = parse_rows(rows, usecols=sorted(places.values()), columns=len(columns))
        return pick(_renumbered(places), table)
    failure = None
    for delimiter, cleaned in _layouts(rows):
        width = len(_cells(cleaned[0], delimiter))
        lines = [header] if header is not None else comments[::-1]
        found = next(filter(None, (column_names(line, width) for line in lines)), None)
        if found is None:
            continue
        names, unit = found
        try:
            table = parse_rows(cleaned, usecols=sorted(names.values()), columns=width, delimiters=(delimiter,))
        except BadFile as error:
            failure = failure or error
            continue
        return pick(_renumbered(names), table, unit=unit)
    if failure is not None:
        raise failure
    if header is not None:
        width = len(_cells(rows[0], delimiter_of(rows[0])))
        if any(column_names(header, n) for n in range(3, 65)):
            raise BadFile(f"names another number of columns than the {width} that its rows have: {HOW}")
        raise BadFile(
            f"is no point cloud: {where} holds neither numbers nor column names x, y, z: {header.strip()[:50]!r}"
        )
    return assign_columns(parse_rows(rows), intensity_first=i_first)


def _renumbered(places: dict[str, int]) -> dict[str, int]:
    """Places among the columns that are read, from places in the file."""
    order = {index: position for position, index in enumerate(sorted(places.values()))}
    return {name: order[index] for name, index in places.items()}


def _blocks(rows: list[str], *, ended: bool) -> tuple[list[list[str]], tuple[str, ...]]:
    """Rows by the counts that stand before them, and what is to be said about the last block."""
    blocks, notes, at = [], (), 0
    while at < len(rows):
        count = whole_number(rows[at], "points")
        block = rows[at + 1 : at + 1 + count]
        if len(block) < count:
            notes = one_short(len(block), count, what="a block", ended=ended)
        if block:
            blocks.append(block)
        at += 1 + count
    if not blocks:
        raise BadFile("holds no point")
    return blocks, notes


def text_lines(data: bytes) -> list[str]:
    """Decode text; a cloud written with any ASCII-compatible encoding will do.

    Raises:
        BadFile: If the bytes are no text.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return split_lines(data.decode("utf-16", errors="replace"))
    data = data.rstrip(b"\0\x1a")  # padding to a block of the disk, the end mark of CP/M
    if b"\0" in data:
        raise BadFile("is no text file: it holds binary data")
    return split_lines(data.removeprefix(b"\xef\xbb\xbf").decode("latin-1"))


def split_lines(text: str) -> list[str]:
    """Lines of text with any kind of line end.

    `str.splitlines` would also break at other control characters, among them a byte of letters such as the UTF-8 of Å.
    """
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def whole_number(line: str, what: str) -> int:
    """A line that holds one whole number.

    Raises:
        BadFile: If it holds anything else.
    """
    if not _is_count(line):
        raise BadFile(f"is damaged: expected a number of {what}, got {line.strip()[:40]!r}")
    return int(line)


def delimiter_of(line: str) -> str | None:
    """Semicolon, comma or tab where the row holds one, None for blanks; commas may be decimal in a row of blanks."""
    words = line.split()
    if ";" not in line and "," in line and len(words) >= 3 and all(map(DECIMAL_COMMA.fullmatch, words)):
        return None
    return next((mark for mark in (";", ",", "\t") if mark in line.strip(BLANK)), None)


def parse_rows(
    lines: Sequence[str],
    *,
    columns: int | None = None,
    usecols: Sequence[int] | None = None,
    delimiters: Sequence[str | None] | None = None,
) -> np.ndarray:
    """Parse rows of numbers of equal length.

    Empty cells, the usual words for a missing value and the Microsoft spellings of NaN become NaN.

    Args:
        lines: The rows; blank ones and comments are skipped.
        columns: How many cells a row must hold; any number from 3 on where it is None.
        usecols: Which columns to read; the others may hold anything.
        delimiters: What may part the cells, in this order; found out where it is None.

    Returns:
        The numbers `[n, columns]`, or `[n, len(usecols)]`, float64.

    Raises:
        BadFile: If a cell is no number or a row is shorter or longer than the first, naming the row.
    """
    lines = [line for line in lines if line.strip(BLANK) and not line.lstrip().startswith(COMMENTS)]
    if not lines:
        raise BadFile("holds no point")
    layouts = _layouts(lines) if delimiters is None else [(mark, list(lines)) for mark in delimiters]
    failure = None
    for delimiter, rows in layouts:
        try:
            table = _parse(rows, delimiter, usecols, columns)
        except (ValueError, IndexError, OverflowError) as error:
            failure = failure or error
            continue
        width = table.shape[1]
        if usecols is None and (width < 3 or width != (columns or width)):
            failure = failure or ValueError(f"has {width} numbers a row, expected {columns or 'at least 3'}")
            continue
        return table
    text = str(failure).split(";")[0].rstrip(".")
    raise BadFile(text if text.startswith("has ") else f"is damaged or no point cloud: {text}") from failure


def _layouts(rows: list[str]) -> list[tuple[str | None, list[str]]]:
    """The ways to cut rows into cells, likeliest first: delimiter and rows, each with and without empty last columns."""
    mark = delimiter_of(rows[0])
    if mark == "\t":
        return [(None, rows), *_ended(rows, "\t")]
    if mark is None:
        return [(None, [row.replace(",", ".") for row in rows] if "," in rows[0] else rows)]
    if mark == ";" and any("," in row for row in rows):
        rows = [row.replace(",", ".") for row in rows]
    return _ended(rows, mark)


def _ended(rows: list[str], mark: str) -> list[tuple[str | None, list[str]]]:
    """Rows that all end with a delimiter, without it and with it; then rows of which some do."""
    ways: list[tuple[str | None, list[str]]] = [(mark, rows)]
    bare = rows
    while all(row.rstrip(BLANK).endswith(mark) for row in bare):
        bare = [row.rstrip(BLANK).removesuffix(mark) for row in bare]
    if bare is not rows:
        ways.insert(0, (mark, bare))
    elif len({row.count(mark) for row in rows}) > 1 and any(row.rstrip(BLANK).endswith(mark) for row in rows):
        ways.append((mark, [row.rstrip(BLANK).removesuffix(mark) for row in rows]))
    return ways


def _parse(rows: list[str], delimiter: str | None, usecols: Sequence[int] | None, columns: int | None) -> np.ndarray:
    """Numbers by NumPy; what it refuses once more with missing values spelt its way."""
    options = {"delimiter": delimiter, "comments": None, "quotechar": '"', "ndmin": 2}
    try:
        table = np.loadtxt(rows, **options)
    except (ValueError, OverflowError):
        rows = [_repaired(row, delimiter) for row in rows]
        if usecols is None:
            return np.loadtxt(rows, **options)
        widths = {len(cells) for cells in _all_cells(rows, delimiter)}
        if widths != {columns or max(widths)}:
            raise ValueError(f"has rows of {min(widths)} to {max(widths)} cells, expected {columns}") from None
        return np.loadtxt(rows, usecols=usecols, **options)
    if usecols is None:
        return table
    if columns is not None and table.shape[1] != columns:
        raise ValueError(f"has {table.shape[1]} numbers a row, expected {columns}")
    return table[:, list(usecols)]


def _all_cells(rows: list[str], delimiter: str | None) -> list[list[str]]:
    return [row.split() for row in rows] if delimiter is None else list(csv.reader(rows, delimiter=delimiter))


def _repaired(row: str, delimiter: str | None) -> str:
    """A row without a comment at its end, its missing values as nan."""
    row = TRAILING_COMMENT.sub("", row)
    row = MICROSOFT.sub(lambda found: "inf" if "INF" in found[0].upper() else "nan", row)
    cells = row.strip(BLANK).split(delimiter) if delimiter else row.split()
    return (delimiter or " ").join("nan" if cell.strip().lower() in MISSING else cell for cell in cells)


def _cells(row: str, delimiter: str | None) -> list[str]:
    (cells,) = _all_cells([row.strip(BLANK)], delimiter)
    return cells


def _is_count(line: str) -> bool:
    """Whether a line holds one whole number."""
    return line.strip().isdecimal() and line.strip().isascii()


def _is_data(line: str) -> bool:
    """Whether a line holds numbers or missing values and no words."""
    row = _repaired(line, delimiter_of(line))
    cells = _cells(row, delimiter_of(row))
    cells = [cell.strip().strip('"').strip() for cell in cells]
    return all(not cell or NUMBER.fullmatch(cell.replace(",", ".", 1)) for cell in cells)
