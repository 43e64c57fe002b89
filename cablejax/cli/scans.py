"""Reading a scan for a command: progress on stderr, the unit, errors in one line."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cablejax.cli.errors import NoResultError
from cablejax.cli.streams import tell

if TYPE_CHECKING:
    from cablejax.io import PointFile


LEAST_MM = 30.0  # no scan of a cable is shorter than its own thickness
FIRST_PIECE = 1_000_000  # points by whose extent the unit is guessed


def say(options: argparse.Namespace, text: str) -> None:
    """A line of progress on stderr, unless `--quiet`."""
    if not options.quiet:
        tell(text)


def load(options: argparse.Namespace, path: str) -> "PointFile":
    """Read a scan in the unit given; if none was, in the file's own, else in mm, or in m where that would be less than
    `LEAST_MM`, with a warning.

    Raises:
        NoResultError: If the file gives no cloud.
    """
    say(options, f"reading {path}")
    scan = _read(options, path, options.unit)
    if options.unit is None and _guessed_unit(scan) == "m":
        scan = _read(options, path, "m")
    scan = _without_misses(options, scan)
    if scan.dropped:
        say(options, f"{scan.dropped:,} invalid returns left out, {len(scan.xyz_mm):,} points kept")
    return scan


def unit_of(options: argparse.Namespace, path: str) -> str:
    """The unit that `load` takes, for a file that is read in pieces: where it is guessed, by the first of them.

    Raises:
        PointFileError: If the file gives no cloud.
    """
    from cablejax.io import iter_points

    if options.unit is not None:
        return options.unit
    scan = next(iter_points(path, unit=None, columns=options.columns, chunk=FIRST_PIECE))
    return scan.unit if scan.stated_unit is not None else _guessed_unit(scan)


def _guessed_unit(scan: "PointFile") -> str:
    """The unit of a file read as mm, by its size, said in a warning; its own where it states one."""
    if scan.stated_unit is not None:
        return scan.stated_unit
    extent = float((scan.xyz_mm.max(axis=0) - scan.xyz_mm.min(axis=0)).max())
    unit = "m" if 0 < extent < LEAST_MM else "mm"
    tell(f"cablejax: warning: no --unit given, the file is taken to be in {unit}: its longest side is {extent:.3g}")
    return unit


def _read(options: argparse.Namespace, path: str, unit: str | None) -> "PointFile":
    """Read a file; without a unit in the one that it states, or in mm."""
    from cablejax.io import PointFileError, read_points

    try:
        return read_points(path, unit=unit, columns=options.columns)
    except (PointFileError, ValueError) as error:
        raise NoResultError(str(error).replace("columns: ", "--columns: ", 1)) from None


def _without_misses(options: argparse.Namespace, scan: "PointFile") -> "PointFile":
    """Leave out points exactly at the origin where there are several: so some scanners write a beam without return.

    Raises:
        NoResultError: If nothing else is left.
    """
    hit = (scan.xyz_mm != 0).any(axis=1)
    misses = int((~hit).sum())
    if misses < 2:
        return scan
    if not hit.any():
        raise NoResultError(f"{scan.path}: all {misses} points are at the origin")
    say(options, f"{misses:,} points at the origin (0, 0, 0) are taken for beams without return")
    kept = {name: None if (field := getattr(scan, name)) is None else field[hit] for name in ("color", "intensity")}
    return replace(scan, xyz_mm=scan.xyz_mm[hit], dropped=scan.dropped + misses, **kept)


def check_output(path: str, endings: tuple[str, ...]) -> None:
    """Refuse a file that cannot be written before the work is done.

    Raises:
        NoResultError: If its folder is missing, it is a folder, or its ending is not among `endings`.
    """
    target = Path(path)
    if target.is_dir():
        raise NoResultError(f"{path}: is a folder, not a file")
    if target.suffix.lower() not in endings:
        raise NoResultError(f"{path}: expected one of the endings {', '.join(endings)}")
    if target.exists() and not target.is_file():
        raise NoResultError(f"{path}: is no regular file")
    if not target.parent.is_dir():
        why = "is no folder" if target.parent.exists() else "does not exist"
        raise NoResultError(f"{path}: the folder {target.parent} {why}")


def make_folder(path: Path) -> None:
    """Make a folder for results, unless it is there.

    Raises:
        NoResultError: If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "is a file" if path.is_file() else error.strerror
        raise NoResultError(f"{path}: cannot be a folder for results ({why})") from None


def save_bytes(path: str, content: bytes) -> None:
    """Write a report or a picture, whole or not at all.

    Raises:
        NoResultError: If it cannot be written.
    """
    from cablejax.io import atomic_write

    try:
        with atomic_write(path) as file:
            file.write(content)
    except OSError as error:
        raise NoResultError(f"{path}: cannot be written ({error.strerror})") from None


def save(path: str, xyz_mm, **fields) -> None:
    """Write a cloud.

    Raises:
        NoResultError: If it cannot be written.
    """
    from cablejax.io import PointFileError, write_points

    try:
        write_points(path, xyz_mm, **fields)
    except PointFileError as error:
        raise NoResultError(str(error)) from None
    except OSError as error:
        raise NoResultError(f"{path}: cannot be written ({error.strerror})") from None


WRITABLE = (".ply", ".pcd", ".xyz", ".csv", ".las", ".laz")


def rows(pairs: list[tuple[str, str]]) -> str:
    """Names and values in two columns."""
    width = max(len(name) for name, _ in pairs)
    return "\n".join(f"  {name:<{width}}  {value}" for name, value in pairs)
