"""What the columns of a table mean: by their names, by the caller's word, or by their values where they leave no doubt."""

import re
from collections.abc import Sequence

import numpy as np

from cablejax.io.raw import UNITS_MM, BadFile, RawCloud, colored

COLUMN_NAMES = {
    "x": ("x", "easting", "pos_x", "point_x", "x_coordinate"),
    "y": ("y", "northing", "pos_y", "point_y", "y_coordinate"),
    "z": ("z", "height", "elevation", "pos_z", "point_z", "z_coordinate"),
    "r": ("r", "red"),
    "g": ("g", "green"),
    "b": ("b", "blue"),
    "i": ("i", "intensity", "reflectance", "scalar_intensity"),
}
SKIPPED = ("index", "id", "time", "row", "column", "nx", "ny", "nz", "class", "skip")
UNIT_IN_NAME = re.compile(r"(.*?)(?:[_.\s-]+|\s*(?<=\w)[\[(]\s*)(um|µm|mm|cm|dm|m|km|in|ft)\s*[\])]?")
BRACKET = re.compile(r"(?<=[\w\"'])\s*[\[(][^\])]*[\])]")
HOW = "say which columns are which, such as --columns index,x,y,z (read_points: columns=)"
LONGEST_NAMES = 4096  # characters of a row of names
RISING_ROWS = 5  # so few rows may rise by chance
FLAG_ROWS, LARGEST_FLAG = 20, 7  # so many rows of nothing but such small numbers are classes or returns, not colours
UNIT_NORMAL = 1e-2


def named_columns(columns: str | Sequence[str]) -> tuple[str, ...]:
    """The meaning of each column, as the caller names them: "x", "y", "z", "r", "g", "b", "i", or "" to leave it out.

    Raises:
        ValueError: If a name is unknown or comes twice, or x, y or z is missing.

    Example:
        >>> named_columns("index,x,y,z,intensity")
        ('', 'x', 'y', 'z', 'i')
    """
    words = [word.strip().lower() for word in (columns.split(",") if isinstance(columns, str) else columns)]
    meanings = {synonym: name for name, synonyms in COLUMN_NAMES.items() for synonym in synonyms}
    unknown = [word for word in words if word not in meanings and word not in SKIPPED]
    if unknown:
        known = ("x", "y", "z", "red", "green", "blue", "intensity", *SKIPPED)
        raise ValueError(f"columns: expected names among {', '.join(known)}, got {unknown[0]!r}")
    found = tuple(meanings.get(word, "") for word in words)
    if any(found.count(axis) != 1 for axis in "xyz") or any(found.count(name) > 1 for name in "rgbi"):
        raise ValueError(f"columns: expected x, y and z once each, others at most once, got {','.join(words)}")
    return found


def column_names(line: str, width: int) -> tuple[dict[str, int], str | None] | None:
    """Which columns a line of names means, and their unit where the names of x, y and z hold one.

    None unless it holds as many names as there are columns, x, y and z among them: prose may hold them too.

    Example:
        >>> column_names("# X [mm], Y [mm], Z [mm]", 3)
        ({'x': 0, 'y': 1, 'z': 2}, 'mm')
    """
    if len(line) > LONGEST_NAMES:
        return None
    line = line.strip(" \r\n").lstrip("#/%").strip(" ")
    bare = BRACKET.sub("", line)
    mark = next((mark for mark in (";", ",", "\t") if mark in bare), None)
    for text in (line, bare):  # a unit is part of its cell, or stands apart where blanks part the cells
        for delimiter in dict.fromkeys((mark, None)):
            words = text.rstrip(delimiter).split(delimiter) if delimiter else text.split()
            if len(words) == width and (found := _meanings(words)):
                return found, _unit(line)
    return None


def _meanings(words: Sequence[str]) -> dict[str, int] | None:
    bare = [_bare(word)[0] for word in words]
    hits = {name: [i for i, word in enumerate(bare) if word in names] for name, names in COLUMN_NAMES.items()}
    found = {name: places[0] for name, places in hits.items() if places}
    return found if {"x", "y", "z"} <= found.keys() else None


def _bare(word: str) -> tuple[str, str | None]:
    """A column's name in small letters without quotes and unit, and the unit."""
    word = word.lower().strip("\"' \t")
    match = UNIT_IN_NAME.fullmatch(word)
    name, unit = (match[1], match[2].replace("µ", "u")) if match else (BRACKET.sub("", word), None)
    return name.strip("\"'[]() "), unit


def _unit(line: str) -> str | None:
    """The one unit that the names of x, y and z are followed by."""
    axes = "|".join(sorted((re.escape(s) for axis in "xyz" for s in COLUMN_NAMES[axis]), key=len, reverse=True))
    units = "|".join(("µm", *UNITS_MM))
    found = re.findall(rf"\b(?:{axes})(?:[_.-]|\"?\s*[\[(]\s*)({units})(?![a-z0-9])", line.lower())
    return found[0].replace("µ", "u") if len(found) == 3 and len(set(found)) == 1 else None


def pick(names: dict[str, int], table: np.ndarray, *, unit: str | None = None) -> RawCloud:
    """A cloud from the columns that have a meaning."""
    xyz = table[:, [names["x"], names["y"], names["z"]]]
    intensity = table[:, names["i"]].astype(np.float32) if "i" in names else None
    cloud = RawCloud(xyz, None, intensity, unit=unit)
    return colored(cloud, table[:, [names[c] for c in "rgb"]]) if {"r", "g", "b"} <= names.keys() else cloud


def assign_columns(table: np.ndarray, *, intensity_first: bool = False) -> RawCloud:
    """Tell columns without names by their number and values: x y z, then what the rest leaves no doubt about.

    Args:
        table: Numbers `[n, columns]`.
        intensity_first: Whether intensity stands before colours, as in PTS.

    Raises:
        BadFile: If the first columns look like an index, a time, or row and column numbers.
    """
    valid = table[np.isfinite(table[:, :3]).all(axis=1)]
    if reason := _in_front(valid):
        raise BadFile(f"is a table without column names, and {reason}: {HOW}")
    names, note = _behind(valid[:, 3:], intensity_first)
    cloud = pick({"x": 0, "y": 1, "z": 2} | names, table)
    return cloud._replace(notes=(*cloud.notes, note)) if note else cloud


def _in_front(table: np.ndarray) -> str | None:
    """Why the first columns are probably no coordinates: there would be room for x, y and z behind them."""
    n, width = table.shape
    if n < 3 or width < 4:
        return None
    first, fourth = table[:, 0], table[:, 3]
    step = np.diff(first)
    if _whole(first) and (step > 0).all():
        return "its first column holds whole numbers that count up, as an index does"
    rest = table[:, 3:]
    if rest.shape[1] == 3 and (_unit_normals(rest) or _eight_bits(rest)):
        return None
    if width >= 5 and _grid(table[:, :2]) and not _whole(fourth):
        return "its first two columns hold whole numbers that count, as rows and columns do"
    varies = first[0] != first[-1]
    if n >= RISING_ROWS and varies and (step >= 0).all() and not _whole(fourth):
        return "its first column never falls, as a time or a place along the scan does"
    return None


def _grid(pair: np.ndarray) -> bool:
    """Whether two columns number the cells of a grid, in its order, each cell once."""
    if not (_whole(pair) and (pair >= 0).all()):
        return False
    ordered = (np.diff(pair, axis=0) >= 0).all(axis=0).any()
    return bool(ordered) and len(np.unique(pair, axis=0)) == len(pair) and bool((np.ptp(pair, axis=0) > 0).any())


def _behind(rest: np.ndarray, intensity_first: bool) -> tuple[dict[str, int], str | None]:
    """Which of the columns behind x y z are colour and intensity, and a note where they are none or in doubt."""
    n, width = rest.shape
    if width == 0 or (width == 3 and _unit_normals(rest)):
        return {}, None
    if width == 1 and not (n >= RISING_ROWS and (np.diff(rest[:, 0]) > 0).all()):
        return {"i": 3}, None
    if width == 3 and _looks_like_color(rest):
        return {"r": 3, "g": 4, "b": 5}, None
    if width == 4:
        color_first, color_last = _looks_like_color(rest[:, :3]), _looks_like_color(rest[:, 1:])
        if color_first and not intensity_first:
            note = f"its columns 4 to 7 are taken for red, green, blue, intensity; if they are not, {HOW}"
            return {"r": 3, "g": 4, "b": 5, "i": 6}, note if color_last else None
        if color_last:
            return {"i": 3, "r": 4, "g": 5, "b": 6}, None
    if width == 6 and _looks_like_color(rest[:, :3]) and _unit_normals(rest[:, 3:]):
        return {"r": 3, "g": 4, "b": 5}, None
    if width == 6 and _unit_normals(rest[:, :3]) and _looks_like_color(rest[:, 3:]):
        return {"r": 6, "g": 7, "b": 8}, None
    return {}, f"what stands behind x, y and z in its rows is left out ({width} numbers without names); {HOW}"


def _whole(values: np.ndarray) -> bool:
    return bool((values % 1 == 0).all())


def _unit_normals(values: np.ndarray) -> bool:
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1) < UNIT_NORMAL).all())


def _eight_bits(values: np.ndarray) -> bool:
    """Whole numbers from 0 to 255: normals are not."""
    return bool(((values >= 0) & (values <= 255)).all()) and _whole(values)


def _looks_like_color(values: np.ndarray) -> bool:
    """Eight bits, and not the classes and return numbers that laser exporters write."""
    flags = len(values) >= FLAG_ROWS and 0 < values.max(initial=0) <= LARGEST_FLAG
    return _eight_bits(values) and not flags
