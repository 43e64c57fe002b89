"""Clouds as text: tables of columns (XYZ, TXT, CSV, PTS) and OBJ vertices."""

from collections.abc import Sequence

import numpy as np

from cablejax.io.columns import HOW, assign_columns, column_names, pick
from cablejax.io.raw import BadFile, RawCloud, colored, join, one_short
from cablejax.io.rows import BLANK, COMMENTS, cells_of, delimiter_of, is_count, is_data, layouts, parse_rows, text_lines

MOST_COLUMNS = 64


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
        if header is None and place < len(rows) and not is_data(rows[place]) and (place == 0 or is_count(rows[0])):
            header = rows.pop(place)
    where = "" if header is None else f"line {every.index(header) + 1}"
    if not rows:
        raise _misread(header or "", where, None)
    blocks, notes = _blocks(rows, ended=not every[-1].strip(BLANK)) if is_count(rows[0]) else ([rows], ())
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
    for delimiter, cleaned in layouts(rows):
        width = len(cells_of(cleaned[0], delimiter))
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
        raise _misread(header, where, len(cells_of(rows[0], delimiter_of(rows[0]))))
    return assign_columns(parse_rows(rows), intensity_first=i_first)


def _misread(header: str, where: str, width: int | None) -> BadFile:
    """Why a row that holds no numbers is no header of the rows behind it, of which `width` is None if there are none."""
    if not any(column_names(header, n) for n in range(3, MOST_COLUMNS)):
        start = header.strip()[:50]
        return BadFile(f"is no point cloud: {where} holds neither numbers nor column names x, y, z: {start!r}")
    if width is None:
        return BadFile("holds no point")
    return BadFile(f"names another number of columns than the {width} that its rows have: {HOW}")


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
    return blocks, notes


def whole_number(line: str, what: str) -> int:
    """A line that holds one whole number.

    Raises:
        BadFile: If it holds anything else.
    """
    if not is_count(line):
        raise BadFile(f"is damaged: expected a number of {what}, got {line.strip()[:40]!r}")
    return int(line)
