"""`cablejax denoise`: outliers out, the rest smoothed, the cloud written."""

import argparse
from typing import Any

from cablejax.cli.main import NoResultError
from cablejax.cli.scans import WRITABLE, check_output, load, rows, save, say


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Read, remove outliers, filter, write."""
    check_output(options.output, WRITABLE)
    scan = load(options, options.scan)
    import numpy as np

    from cablejax.ops import adaptive_filter, statistical_outliers

    cloud = scan.cloud()
    if len(scan.xyz_mm) <= options.neighbors:
        raise NoResultError(
            f"{options.scan}: too few points: {len(scan.xyz_mm)} where more than --neighbors {options.neighbors} are needed"
        )
    say(options, f"removing outliers from {len(scan.xyz_mm):,} points")
    keep = statistical_outliers(cloud, std_ratio=options.std_ratio).keep
    xyz, width = cloud.xyz, None
    if not options.no_filter:
        say(options, "smoothing")
        filtered = adaptive_filter(cloud._replace(mask=keep), k=options.neighbors, order=options.order)
        xyz, width = filtered.xyz, float(np.median(np.asarray(filtered.width)[np.asarray(keep)]))
    rest = np.asarray(keep)
    moved = np.linalg.norm(np.asarray(xyz - cloud.xyz, dtype=np.float64)[rest], axis=1)
    color = None if scan.color is None else scan.color[rest]
    intensity = None if scan.intensity is None else scan.intensity[rest]
    out = np.asarray(xyz, dtype=np.float64)[rest] + scan.shift_mm
    save(options.output, out, unit=scan.unit, color=color, intensity=intensity)
    return {
        "file": str(scan.path),
        "output": options.output,
        "points": len(rest),
        "removed": int((~rest).sum()),
        "moved_rms_mm": float(np.sqrt(np.mean(moved**2))),
        "kernel_width_mm": width,
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    width = result["kernel_width_mm"]
    return rows(
        [
            ("points", f"{result['points']:,}"),
            ("removed", f"{result['removed']:,} outliers"),
            ("moved", f"{result['moved_rms_mm']:.3g} mm (root mean square)" if width is not None else "not smoothed"),
            ("kernel width", "none" if width is None else f"{width:.3g} mm (median)"),
            ("written", result["output"]),
        ]
    )
