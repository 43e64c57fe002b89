"""Leica's text formats: PTS (a count, then rows) and PTX (a grid with pose, zeros where nothing came back)."""

import numpy as np

from cablejax.io.raw import BadFile, RawCloud, as_color, join
from cablejax.io.text import assign_columns, is_number, parse_rows, split_row, text_lines

PTX_HEADER_LINES = 10


def read_pts(data: bytes) -> RawCloud:
    """Read PTS: one or several blocks of a count and as many rows `x y z [intensity [r g b]]`.

    Raises:
        BadFile: If a block is shorter or longer than its count.
    """
    lines = [line for line in text_lines(data) if line.strip()]
    if lines and len(split_row(lines[0])) >= 3:
        return assign_columns(parse_rows(lines), intensity_first=True)
    clouds, at = [], 0
    while at < len(lines):
        count = _count(lines[at], "points")
        block = lines[at + 1 : at + 1 + count]
        if len(block) < count:
            raise BadFile(f"is truncated: a block promises {count:,} points, {len(block):,} are there")
        if count:
            clouds.append(assign_columns(parse_rows(block), intensity_first=True))
        at += 1 + count
    if not clouds:
        raise BadFile("holds no point")
    return join(clouds)


def read_ptx(data: bytes) -> RawCloud:
    """Read PTX: scans of columns x rows points, each moved by its pose. (0, 0, 0) stands for "no return".

    Raises:
        BadFile: If a header is damaged or a scan is shorter or longer than its grid.
    """
    lines = [line for line in text_lines(data) if line.strip()]
    clouds, at = [], 0
    while at < len(lines):
        count = _count(lines[at], "columns") * _count(lines[at + 1] if at + 1 < len(lines) else "", "rows")
        pose = parse_rows(lines[at + 6 : at + PTX_HEADER_LINES], columns=4)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise BadFile("has a damaged PTX header: expected a transformation of four rows of four numbers")
        block = lines[at + PTX_HEADER_LINES : at + PTX_HEADER_LINES + count]
        if len(block) < count:
            raise BadFile(f"is truncated: a scan promises {count:,} points, {len(block):,} are there")
        if count:
            clouds.append(_ptx_scan(parse_rows(block), pose))
        at += PTX_HEADER_LINES + count
    if not clouds:
        raise BadFile("holds no point")
    return join(clouds)


def _ptx_scan(table: np.ndarray, pose: np.ndarray) -> RawCloud:
    """Drop empty returns, then move the rest: PTX multiplies row vectors from the left, translation last."""
    if table.shape[1] not in (3, 4, 7):
        raise BadFile(f"has {table.shape[1]} numbers a row, expected 3, 4 or 7")
    valid = table[:, :3].any(axis=1)
    table = table[valid]
    intensity = table[:, 3].astype(np.float32) if table.shape[1] > 3 else None
    color = as_color(table[:, 4:7]) if table.shape[1] == 7 else None
    return RawCloud(table[:, :3] @ pose[:3, :3] + pose[3, :3], color, intensity, int((~valid).sum()))


def _count(line: str, what: str) -> int:
    """A line that holds one whole number."""
    cells = split_row(line)
    if len(cells) != 1 or not is_number(cells[0]) or not cells[0].isdigit():
        raise BadFile(f"is damaged: expected a number of {what}, got {line.strip()[:40]!r}")
    return int(cells[0])
