"""Rows of numbers as text: decoding, delimiters, missing values, and NumPy's parser behind them."""

import csv
import re
from collections.abc import Sequence

import numpy as np

from cablejax.io.raw import BadFile

COMMENTS = ("#", "//", "%")
BLANK = " \r\n"
NUMBER = re.compile(r"[+-]?((\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"[+-]?(\d+|\d*,\d+)(e[+-]?\d+)?", re.IGNORECASE)
TRAILING_COMMENT = re.compile(r"\s(#|//|%).*$")
# What the C library of Microsoft prints: 1.#QNAN, -1.#IND00, 1.#INF, -nan(ind), nan(snan).
MICROSOFT = re.compile(r"[+-]?\d\.#(QNAN|SNAN|IND|INF|J)\w*|[+-]?nan\((ind|snan)\)", re.IGNORECASE)
MISSING = ("", '""', "na", "n/a", "null", "none", "-")


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
    ways = layouts(lines) if delimiters is None else [(mark, list(lines)) for mark in delimiters]
    failure = None
    for delimiter, rows in ways:
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


def layouts(rows: list[str]) -> list[tuple[str | None, list[str]]]:
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
        widths = {len(cells) for cells in all_cells(rows, delimiter)}
        if widths != {columns or max(widths)}:
            raise ValueError(f"has rows of {min(widths)} to {max(widths)} cells, expected {columns}") from None
        return np.loadtxt(rows, usecols=usecols, **options)
    if usecols is None:
        return table
    if columns is not None and table.shape[1] != columns:
        raise ValueError(f"has {table.shape[1]} numbers a row, expected {columns}")
    return table[:, list(usecols)]


def _repaired(row: str, delimiter: str | None) -> str:
    """A row without a comment at its end, its missing values as nan."""
    row = TRAILING_COMMENT.sub("", row)
    row = MICROSOFT.sub(lambda found: "inf" if "INF" in found[0].upper() else "nan", row)
    cells = row.strip(BLANK).split(delimiter) if delimiter else row.split()
    return (delimiter or " ").join("nan" if cell.strip().lower() in MISSING else cell for cell in cells)


def all_cells(rows: list[str], delimiter: str | None) -> list[list[str]]:
    """The cells of every row; quotes may hold the delimiter.

    Raises:
        BadFile: If a quote does not end within what is a cell to the csv module.
    """
    if delimiter is None:
        return [row.split() for row in rows]
    try:
        return list(csv.reader(rows, delimiter=delimiter))
    except csv.Error as error:
        raise BadFile(f"is damaged or no point cloud: {error}") from error


def cells_of(row: str, delimiter: str | None) -> list[str]:
    """The cells of one row."""
    (cells,) = all_cells([row.strip(BLANK)], delimiter)
    return cells


def is_count(line: str) -> bool:
    """Whether a line holds one whole number that can count something."""
    return re.fullmatch(r"\s*[0-9]{1,18}\s*", line) is not None


def is_data(line: str) -> bool:
    """Whether a line holds numbers or missing values and no words."""
    row = _repaired(line, delimiter_of(line))
    cells = cells_of(row, delimiter_of(row))
    cells = [cell.strip().strip('"').strip() for cell in cells]
    return all(not cell or NUMBER.fullmatch(cell.replace(",", ".", 1)) for cell in cells)
