"""Accuracy of the measured diameter on simulated scans with known truth, beside a RANSAC cylinder.

    python -m benchmarks.measure --scans 13 --out results/measure_accuracy.json

Each row is a preset, an arc and a share of outliers; each scan another cable size and another random key. "stations" is
the measurement with each point's scanner position given, "blind" without. The peer is what is commonly done: a straight
cylinder through pairs of oriented points by RANSAC, fitted to its inliers by least squares.
"""

import argparse
import math
import time

import jax
import numpy as np

from cablejax.io import provenance, write_json
from cablejax.measure import MeasureError, measure_cable
from cablejax.measure.search import find_candidates
from cablejax.measure.thinning import surface
from cablejax.simulate import catalogue, simulate_scan

ROWS = (
    ("half arc", {"arc_deg": 180.0, "outlier_fraction": 0.02}),
    ("half arc, bend of 15 D", {"arc_deg": 180.0, "outlier_fraction": 0.02, "shape": "bend"}),
    ("quarter arc, 10 % outliers", {"arc_deg": 90.0, "outlier_fraction": 0.1}),
    ("60 degree arc", {"arc_deg": 60.0, "outlier_fraction": 0.02}),
)


def ransac_diameter(xyz: np.ndarray, seed: int) -> float:
    """Diameter of the best straight cylinder."""
    found = find_candidates(surface(xyz), rng=np.random.default_rng(seed))
    return 2 * found[0].cylinder.radius_mm if found else math.nan


def one_scan(options: dict, *, index: int, preset: str, points: int) -> list[dict]:
    """Errors and claims of every method on one scan."""
    cables = catalogue()
    cable = cables[index % len(cables)]
    extra = {"bend_radius_mm": 15 * cable.diameter_mm} if options.get("shape") == "bend" else {}
    scan = simulate_scan(cable, n_points=points, preset=preset, key=jax.random.key(1000 + index), **options, **extra)
    xyz, station = np.asarray(scan.xyz_mm, dtype=np.float64), np.asarray(scan.station)
    sizes = {other.name: other.diameter_mm for other in cables}
    out = [{"method": "RANSAC cylinder", "error_mm": ransac_diameter(xyz, index) - scan.true_diameter_mm}]
    for method, label in (("blind", None), ("stations", station)):
        start = time.perf_counter()
        try:
            result = measure_cable(xyz, station=label, catalogue=sizes)
        except MeasureError as error:
            out.append({"method": method, "refused": str(error)})
            continue
        row = {"method": method, "error_mm": result.diameter_mm - scan.true_diameter_mm, "std_mm": result.std_mm}
        right = next(iter(result.nominal)) == cable.name
        out.append({**row, "nominal_right": right, "seconds": time.perf_counter() - start})
    return out


def summary(rows: list[dict]) -> dict[str, float | int]:
    """Root mean square and mean error, and how often the interval held the truth."""
    done = [row for row in rows if "error_mm" in row and math.isfinite(row["error_mm"])]
    error = np.array([row["error_mm"] for row in done])
    out: dict[str, float | int] = {"scans": len(rows), "refused": len(rows) - len(done)}
    if len(done) == 0:
        return out
    out |= {"rmse_mm": float(np.sqrt(np.mean(error**2))), "bias_mm": float(error.mean())}
    if "std_mm" in done[0]:
        std = np.array([row["std_mm"] for row in done])
        out["coverage"] = float(np.mean(np.abs(error) < 1.96 * std))
        out["mean_std_mm"] = float(std.mean())
        out["nominal_right"] = float(np.mean([row["nominal_right"] for row in done]))
        out["median_seconds"] = float(np.median([row["seconds"] for row in done]))
    return out


def main() -> None:
    """Measure, print, and write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=13, help="scans a row (default: 13, one a size)")
    parser.add_argument("--points", type=int, default=53_135)
    parser.add_argument("--preset", default="line-laser")
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    table = []
    for name, scan in ROWS:
        rows = [
            row
            for index in range(options.scans)
            for row in one_scan(scan, index=index, preset=options.preset, points=options.points)
        ]
        for method in ("RANSAC cylinder", "blind", "stations"):
            line = {"row": name, "method": method, **summary([row for row in rows if row["method"] == method])}
            table.append(line)
            print(
                "  ".join(
                    f"{key} {value:.4g}" if isinstance(value, float) else str(value) for key, value in line.items()
                ),
                flush=True,
            )
    if options.out:
        seeds = [1000 + index for index in range(options.scans)]
        config = {"preset": options.preset, "points": options.points}
        write_json(options.out, {"table": table, "provenance": provenance(seeds=seeds, config=config)})


if __name__ == "__main__":
    main()
