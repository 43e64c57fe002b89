"""`cablejax info`: what a point file holds."""

import argparse
from pathlib import Path
from typing import Any

from cablejax.batch.table import Column
from cablejax.cli import folder
from cablejax.cli.arguments import add_scan
from cablejax.cli.scans import load, rows

SCHEMA = "info-rows/1"
COLUMNS = (
    Column("points", "whole", "valid points"),
    Column("dropped", "whole", "invalid returns left out"),
    Column("unit", "text", "unit that the file was read in"),
    Column("x_mm", "number", "extent along x"),
    Column("y_mm", "number", "extent along y"),
    Column("z_mm", "number", "extent along z"),
    Column("spacing_mm", "number", "median distance to the nearest point"),
    Column("color", "flag", "whether it has colours"),
    Column("intensity", "flag", "whether it has intensities"),
)


HELP = "what a point file holds: points, extent, spacing, invalid returns"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_scan(parser)
    folder.add_arguments(parser)


def run(options: argparse.Namespace) -> dict[str, Any]:
    """What a file, or every file of a folder, holds."""
    if Path(options.scan).is_dir():
        return folder.run_folder(options)
    folder.refuse_options(options)
    return one(options)


def rows_of(result: dict[str, Any]) -> list[dict[str, Any]]:
    """A row of a folder's table."""
    low, high = result["minimum_mm"], result["maximum_mm"]
    extent = {f"{axis}_mm": b - a for axis, a, b in zip("xyz", low, high, strict=True)}
    same = ("points", "dropped", "unit", "spacing_mm", "color", "intensity")
    return [{**{name: result[name] for name in same}, **extent}]


def one(options: argparse.Namespace) -> dict[str, Any]:
    """Count, extent, spacing and what else the file carries."""
    import numpy as np
    from scipy.spatial import KDTree

    scan = load(options, options.scan)
    xyz = scan.xyz_mm - scan.shift_mm
    sample = xyz[np.random.default_rng(0).permutation(len(xyz))[:2000]]
    spacing = float(np.median(KDTree(xyz).query(sample, k=2)[0][:, 1])) if len(xyz) > 1 else None
    return {
        "file": str(scan.path),
        "unit": scan.unit,
        "points": len(xyz),
        "dropped": scan.dropped,
        "minimum_mm": scan.xyz_mm.min(axis=0).tolist(),
        "maximum_mm": scan.xyz_mm.max(axis=0).tolist(),
        "spacing_mm": spacing,
        "color": scan.color is not None,
        "intensity": scan.intensity is not None,
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    if "rows" in result:
        return folder.table(result, lambda row: f"{row['points']:,} points, read as {row['unit']}")
    low, high = result["minimum_mm"], result["maximum_mm"]
    extent = " x ".join(f"{b - a:.6g}" for a, b in zip(low, high, strict=True))
    carried = [name for name in ("color", "intensity") if result[name]]
    return rows(
        [
            ("file", result["file"]),
            ("points", f"{result['points']:,} ({result['dropped']:,} invalid returns left out)"),
            ("extent", f"{extent} mm, read as {result['unit']}"),
            ("from", " ".join(f"{value:.6g}" for value in low) + " mm"),
            ("to", " ".join(f"{value:.6g}" for value in high) + " mm"),
            ("spacing", "none" if result["spacing_mm"] is None else f"{result['spacing_mm']:.3g} mm (median)"),
            ("also holds", ", ".join(carried) or "coordinates alone"),
        ]
    )
