"""Leica's PTX: scans as grids with a pose, zeros where nothing came back."""

import numpy as np

from cablejax.io.raw import BadFile, RawCloud, check_rotation, colored, join, one_short
from cablejax.io.rows import BLANK, COMMENTS, parse_rows, text_lines
from cablejax.io.text import whole_number

HEADER_LINES = 10


def read_ptx(data: bytes) -> RawCloud:
    """Read PTX: scans of columns x rows points, each moved by its pose. (0, 0, 0) stands for "no return".

    Raises:
        BadFile: If a header is damaged, its pose is no rotation, or a scan is shorter or longer than its grid.
    """
    every = text_lines(data)
    lines = [line for line in every if line.strip(BLANK) and not line.lstrip().startswith(COMMENTS)]
    clouds, notes, at = [], (), 0
    while at < len(lines):
        count = whole_number(lines[at], "columns") * whole_number(lines[at + 1] if at + 1 < len(lines) else "", "rows")
        pose = _pose(lines[at + 6 : at + HEADER_LINES])
        block = lines[at + HEADER_LINES : at + HEADER_LINES + count]
        if len(block) < count:
            notes = one_short(len(block), count, what="a scan", ended=not every[-1].strip(BLANK))
        if block:
            clouds.append(_scan(parse_rows(block), pose))
        at += HEADER_LINES + count
    if not clouds:
        raise BadFile("holds no point")
    return join([*clouds, RawCloud(np.zeros((0, 3)), notes=notes)])


def _pose(lines: list[str]) -> np.ndarray:
    """The rigid motion `[4, 4]`, to multiply row vectors from the right: its last row is the translation.

    Raises:
        BadFile: If it is no rigid motion in this form.
    """
    pose = parse_rows(lines, columns=4)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise BadFile("has a damaged PTX header: expected a transformation of four rows of four numbers")
    if not np.allclose(pose[:, 3], (0, 0, 0, 1), atol=1e-6):
        raise BadFile(f"has a pose whose last column is {pose[:, 3].tolist()}, expected 0 0 0 1")
    check_rotation(pose[:3, :3])
    return pose


def _scan(table: np.ndarray, pose: np.ndarray) -> RawCloud:
    """Drop empty returns, then move the rest: PTX multiplies row vectors from the left, translation last."""
    if table.shape[1] not in (3, 4, 7):
        raise BadFile(f"has {table.shape[1]} numbers a row, expected 3, 4 or 7")
    valid = table[:, :3].any(axis=1)
    table = table[valid]
    intensity = table[:, 3].astype(np.float32) if table.shape[1] > 3 else None
    moved = table[:, :3] @ pose[:3, :3] + pose[3, :3]
    cloud = RawCloud(moved, None, intensity, int((~valid).sum()))
    return colored(cloud, table[:, 4:7]) if table.shape[1] == 7 else cloud
