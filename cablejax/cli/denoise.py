"""`cablejax denoise`: outliers out, the rest smoothed, the cloud written; large files tile by tile."""

import argparse
import contextlib
from pathlib import Path
from typing import Any

from cablejax.batch.table import Column
from cablejax.cli import folder
from cablejax.cli.arguments import add_scan
from cablejax.cli.capacity import padded
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import WRITABLE, check_output, load, rows, save, say, unit_of
from cablejax.cli.streams import tell

LARGE = 1 << 28  # bytes of a file from which on it is cleaned in tiles unasked
TILE_POINTS = 1 << 18
CHUNK = 1_000_000


SCHEMA = "denoise-rows/1"
COLUMNS = (
    Column("output", "text", "file written"),
    Column("points", "whole", "valid points read"),
    Column("removed", "whole", "outliers among them"),
    Column("moved_rms_mm", "number", "root mean square of how far points were moved"),
    Column("kernel_width_mm", "number", "mean width of the filter's kernel; empty with `--no-filter`"),
    Column("tiles", "whole", "tiles; empty where the cloud was cleaned at once"),
)


HELP = "remove outliers, smooth with the adaptive filter, write the cloud"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_scan(parser)
    parser.add_argument(
        "output", help="file to write: .ply, .pcd, .xyz, .csv, .las or .laz; a folder for a folder of scans"
    )
    parser.add_argument("--neighbors", type=int, default=100, metavar="K", help="of the filter (default: 100)")
    parser.add_argument(
        "--order", type=int, choices=(0, 1, 2), default=2,
        help="local surface: 0 the mean of the paper's eq. (8), which shrinks a cable; 1 plane; 2 quadric (default)",
    )  # fmt: skip
    parser.add_argument("--std-ratio", type=float, default=2.0, help="outliers beyond so many deviations (default: 2)")
    parser.add_argument("--no-filter", action="store_true", help="remove outliers alone")
    parser.add_argument(
        "--tile", type=int, metavar="POINTS",
        help="work in tiles of so many points, for files larger than memory; the result is the same, and a killed run "
        "goes on when called again (default: 262144 for files from 256 MB, else none)",
    )  # fmt: skip
    folder.add_arguments(parser)


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Clean a scan, or every scan of a folder into another folder."""
    if Path(options.scan).is_dir():
        target = Path(options.output)
        if target.resolve() == Path(options.scan).resolve():
            raise NoResultError(f"{target}: expected another folder than that of the scans")
        return folder.run_folder(options, {"output": lambda scan: target / _output_name(scan.name)})
    folder.refuse_options(options, "csv", "jsonl")
    return one(options)


def _output_name(name: str) -> str:
    """The source's own name where its format can be written."""
    return name if Path(name).suffix.lower() in WRITABLE else f"{name}.ply"


def rows_of(result: dict[str, Any]) -> list[dict[str, Any]]:
    """A row of a folder's table."""
    return [{column.name: result.get(column.name) for column in COLUMNS}]


def one(options: argparse.Namespace) -> dict[str, Any]:
    """Read, remove outliers, filter, write."""
    check_output(options.output, WRITABLE)
    if options.neighbors < 1:
        raise NoResultError(f"--neighbors: expected at least 1, got {options.neighbors}")
    source = Path(options.scan)
    if options.tile is not None or (source.is_file() and source.stat().st_size >= LARGE):
        return _tiled(options, options.tile or TILE_POINTS)
    if options.scheduler is not None:
        raise NoResultError("--scheduler: is for a folder of scans, or one with --tile")
    return _whole(options)


def _whole(options: argparse.Namespace) -> dict[str, Any]:
    """The whole cloud at once."""
    scan = load(options, options.scan)
    import numpy as np

    from cablejax.cli.kernels import cleaned, without_outliers

    cloud, n = padded(scan), len(scan.xyz_mm)
    if n <= options.neighbors:
        raise NoResultError(
            f"{options.scan}: too few points: {n} where more than --neighbors {options.neighbors} are needed"
        )
    say(options, f"removing outliers from {n:,} points" + ("" if options.no_filter else ", smoothing"))
    xyz, width = cloud.xyz, None
    if options.no_filter:
        keep = without_outliers(cloud, np.float32(options.std_ratio))
    else:
        xyz, keep, widths = cleaned(cloud, np.float32(options.std_ratio), k=options.neighbors, order=options.order)
        width = float(np.mean(np.asarray(widths, dtype=np.float64)[np.asarray(keep)]))
    xyz, before, rest = (np.asarray(array)[:n] for array in (xyz, cloud.xyz, keep))
    if not rest.any():
        raise NoResultError(f"{options.scan}: outlier removal left no point; a larger --std-ratio keeps more")
    moved = np.linalg.norm((xyz - before).astype(np.float64)[rest], axis=1)
    color = None if scan.color is None else scan.color[rest]
    intensity = None if scan.intensity is None else scan.intensity[rest]
    out = xyz[rest].astype(np.float64) + scan.shift_mm
    save(options.output, out, unit=scan.unit, color=color, intensity=intensity)
    return {
        "file": str(scan.path),
        "output": options.output,
        "points": len(rest),
        "removed": int((~rest).sum()),
        "moved_rms_mm": float(np.sqrt(np.mean(moved**2))),
        "kernel_width_mm": width,
        "tiles": None,
        "halo_mm": None,
        "cut": None,
    }


def _tiled(options: argparse.Namespace, tile_points: int) -> dict[str, Any]:
    """Tile by tile, for files larger than memory; a run that was killed goes on."""
    from cablejax.batch import EngineError, engine_for
    from cablejax.io import PointFileError
    from cablejax.tiles import Settings, TileError, denoise_file

    settings = Settings(
        std_ratio=options.std_ratio, k=options.neighbors, order=options.order, smooth=not options.no_filter
    )
    try:
        engine = engine_for(jobs=options.jobs, scheduler=options.scheduler)
    except ValueError as error:
        raise NoResultError(f"--{error}") from None
    try:
        with contextlib.closing(engine):
            result = denoise_file(
                options.scan, options.output, settings=settings, unit=unit_of(options, options.scan), columns=options.columns,
                tile_points=tile_points, chunk=CHUNK, engine=engine,
                progress=lambda stage, done, total: say(options, f"{stage}: {done:,} of {total:,}"),
            )  # fmt: skip
    except (PointFileError, TileError, EngineError, ValueError) as error:
        raise NoResultError(str(error)) from None
    except OSError as error:
        raise NoResultError(f"{options.output}: cannot work beside it ({error.strerror})") from None
    if result.cut:
        tell(
            f"cablejax: warning: {result.cut:,} points depend on others beyond the halo of their tile "
            f"({result.halo_mm:.3g} mm) and may differ from those of the whole cloud; a larger --tile has none"
        )
    return {
        "file": options.scan,
        "output": options.output,
        "points": result.points,
        "removed": result.removed,
        "moved_rms_mm": result.moved_rms_mm,
        "kernel_width_mm": None if options.no_filter else result.width_mm,
        "tiles": result.tiles,
        "halo_mm": result.halo_mm,
        "cut": result.cut,
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    if "rows" in result:
        return folder.table(result, lambda row: f"{row['removed']:,} of {row['points']:,} points removed")
    width = result["kernel_width_mm"]
    tiles = [("tiles", f"{result['tiles']:,}, halo {result['halo_mm']:.3g} mm")] if result["tiles"] else []
    return rows(
        [
            ("points", f"{result['points']:,}"),
            *tiles,
            ("removed", f"{result['removed']:,} outliers"),
            ("moved", f"{result['moved_rms_mm']:.3g} mm (root mean square)" if width is not None else "not smoothed"),
            ("kernel width", "none" if width is None else f"{width:.3g} mm (mean)"),
            ("written", result["output"]),
        ]
    )
