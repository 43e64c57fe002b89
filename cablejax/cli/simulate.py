"""`cablejax simulate`: a scan of a catalogue cable with known truth."""

import argparse
from typing import Any

from cablejax.cli.main import NoResultError
from cablejax.cli.scans import WRITABLE, check_output, rows, save, say


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Simulate and write."""
    check_output(options.output, WRITABLE)
    import jax
    import numpy as np

    from cablejax.simulate import catalogue, simulate_scan

    try:
        sizes = {cable.size_mm2: cable for cable in catalogue(options.voltage)}
        if options.size not in sizes:
            known = ", ".join(f"{size:g}" for size in sizes)
            raise ValueError(f"size: expected one of {known} mm2, got {options.size:g}")
        say(options, f"simulating {options.points:,} points")
        scan = simulate_scan(
            sizes[options.size],
            n_points=options.points,
            preset=options.preset,
            shape=options.shape,
            length_mm=options.length,
            arc_deg=options.arc,
            outlier_fraction=options.outliers,
            key=jax.random.key(options.seed),
        )
    except ValueError as error:
        raise NoResultError(str(error)) from None
    save(options.output, np.asarray(scan.xyz_mm, dtype=np.float64))
    return {
        "output": options.output,
        "unit": "mm",
        "points": len(scan.xyz_mm),
        "true_diameter_mm": float(scan.true_diameter_mm),
        "cable": sizes[options.size].name,
        "shape": scan.shape,
        "preset": scan.preset,
        "outliers": int(scan.is_outlier.sum()),
        "seed": options.seed,
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    return rows(
        [
            ("written", f"{result['output']}, in mm"),
            ("cable", f"{result['cable']}, true diameter {result['true_diameter_mm']:.3f} mm"),
            ("scan", f"{result['points']:,} points, {result['preset']}, {result['shape']}"),
            ("outliers", f"{result['outliers']:,}"),
        ]
    )
