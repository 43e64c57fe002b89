"""`--export`: what `measure` hands on to other programs, as files of a folder."""

import argparse
import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablejax import __version__
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import make_folder, say
from cablejax.optional import require

if TYPE_CHECKING:
    from cablejax.io import PointFile
    from cablejax.measure import CableMeasurement

FORMATS = ("ply", "laz", "csv", "dxf", "html")
USUAL = ("ply", "csv", "html")
NEEDED = {"laz": ("laspy",), "dxf": ("ezdxf",), "html": ("jinja2", "matplotlib")}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of exports."""
    parser.add_argument(
        "--export", metavar="FOLDER",
        help="write deviations (PLY, LAZ), axis and sections (CSV), axis and cylinders (DXF) and a protocol to print (HTML); "
        "for a folder of scans, and with --all for each cable, a folder each",
    )  # fmt: skip
    parser.add_argument(
        "--formats", nargs="+", choices=FORMATS, default=list(USUAL), metavar="FORMAT",
        help=f"of --export: {', '.join(FORMATS)} (default: {' '.join(USUAL)})",
    )  # fmt: skip


def check(options: argparse.Namespace) -> None:
    """Refuse what cannot be written before the work is done.

    Raises:
        MissingPackageError: If a format's package is not installed.
        NoResultError: If the folder cannot be made.
    """
    if options.export is not None:
        for name in options.formats:
            require(*NEEDED.get(name, ()), why=f"--formats {name}")
        make_folder(Path(options.export))


def write(
    options: argparse.Namespace, scan: "PointFile", measured: "CableMeasurement", read: Any, sizes: Any,
    *, number: int | None = None,
) -> list[str] | None:  # fmt: skip
    """Write the files, of one cable among several into a folder with its number; their paths, None without `--export`.

    Raises:
        NoResultError: If one cannot be written.
    """
    if options.export is None:
        return None
    folder, name, written = Path(options.export), Path(options.scan).name, []
    if number is not None:
        folder, name = folder / f"cable-{number}", f"{name}, cable {number}"
        make_folder(folder)
    try:
        for kind in dict.fromkeys(options.formats):
            written += WRITERS[kind](folder, options, scan, measured, read, sizes, name)
    except OSError as error:
        raise NoResultError(f"{folder}: cannot be written ({error.strerror or error})") from None
    for path in written:
        say(options, f"export: {path}")
    return [str(path) for path in written]


def _deviations(name: str) -> Any:
    def write_it(folder: Path, options: argparse.Namespace, scan: "PointFile", measured: Any, *_: Any) -> list[Path]:
        from cablejax.export import write_deviations

        path = folder / f"deviations.{name}"
        write_deviations(path, measured, scan.xyz_mm, unit=scan.unit)
        return [path]

    return write_it


def _tables(folder: Path, options: argparse.Namespace, scan: Any, measured: Any, *_: Any) -> list[Path]:
    from cablejax.export import write_axis, write_sections

    write_axis(folder / "axis.csv", measured)
    write_sections(folder / "sections.csv", measured)
    return [folder / "axis.csv", folder / "sections.csv"]


def _drawing(folder: Path, options: argparse.Namespace, scan: Any, measured: Any, *_: Any) -> list[Path]:
    from cablejax.export import write_drawing

    write_drawing(folder / "cable.dxf", measured)
    return [folder / "cable.dxf"]


def _protocol(
    folder: Path, options: argparse.Namespace, scan: "PointFile", measured: Any, read: Any, sizes: Any, title: str
) -> list[Path]:
    from cablejax.export import protocol_page
    from cablejax.io import atomic_write

    changed = datetime.datetime.fromtimestamp(Path(options.scan).stat().st_mtime, datetime.UTC)
    source = {
        "file": Path(options.scan).name,
        "last changed": changed.isoformat(sep=" ", timespec="seconds"),
        "points": f"{len(scan.xyz_mm):,}, read in {scan.unit}",
        "evaluated by": f"cablejax {__version__}",
    }
    limits = None if options.tolerance is None else (options.tolerance[0], options.tolerance[1])
    html = protocol_page(measured, title=title, source=source, read=read, sizes=sizes, limits_mm=limits)
    with atomic_write(folder / "protocol.html") as file:
        file.write(html.encode(errors="backslashreplace"))  # file names may be no text
    return [folder / "protocol.html"]


WRITERS = {
    "ply": _deviations("ply"),
    "laz": _deviations("laz"),
    "csv": _tables,
    "dxf": _drawing,
    "html": _protocol,
}
