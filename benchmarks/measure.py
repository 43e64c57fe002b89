"""Accuracy of the measured diameter on simulated scans with known truth, beside a RANSAC cylinder.

    CABLEJAX_DATA=... python -m benchmarks.measure --scans 13 --out results/benchmarks/measure.json

Each row is a preset, an arc and a share of outliers; each scan another cable size and another random key. "in scan order"
is the measurement of the rows as the scanner gave them, so that the sweeps show; "shuffled" of the same rows in random
order. The peer is what is commonly done: a straight cylinder through pairs of oriented points by RANSAC, fitted to its
inliers by least squares. With CABLEJAX_DATA the cylinders of Fit4CAD follow, with noise of 0.5 % of the radius added and
without the search (`benchmarks.fit4cad` sends them through it), and real round things for what they are. Last the time of one
warm measurement. `--rows` picks some; those of an earlier run are kept in the file. `benchmarks.coverage` looks at the interval.
"""

import argparse
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

from benchmarks import record
from benchmarks.fit4cad import cylinders
from cablejax.geometry.robust import COVERAGE
from cablejax.io import read_points
from cablejax.measure import MeasureError, measure_cable
from cablejax.measure.find.cylinder import frame
from cablejax.measure.find.hypotheses import find_candidates
from cablejax.measure.find.surface import surface
from cablejax.measure.fit.axis import sampled
from cablejax.measure.fit.least_squares import fit_cable
from cablejax.measure.shape.sections import arc_of
from cablejax.simulate import catalogue, simulate_scan

ROWS = (
    ("half arc", {"arc_deg": 180.0, "outlier_fraction": 0.02}),
    ("half arc, bend of 15 D", {"arc_deg": 180.0, "outlier_fraction": 0.02, "shape": "bend"}),
    ("quarter arc, 10 % outliers", {"arc_deg": 90.0, "outlier_fraction": 0.1}),
    ("60 degree arc", {"arc_deg": 60.0, "outlier_fraction": 0.02}),
)
PARTS = ("simulated", "fit4cad", "real", "time")
METHODS = ("RANSAC cylinder", "in scan order", "shuffled")


def ransac_diameter(xyz: np.ndarray, seed: int) -> float:
    """Diameter of the best straight cylinder."""
    found = find_candidates(surface(xyz), rng=np.random.default_rng(seed))
    return 2 * found[0].cylinder.radius_mm if found else math.nan


def one_scan(options: dict, *, index: int, preset: str, points: int) -> list[dict]:
    """Errors and claims of every method on one scan."""
    cables = catalogue()
    cable = cables[index % len(cables)]
    extra: dict = {"length_mm": 13.5 * cable.diameter_mm}
    if options.get("shape") == "bend":
        extra["bend_radius_mm"] = 15 * cable.diameter_mm
    scan = simulate_scan(cable, n_points=points, preset=preset, key=jax.random.key(1000 + index), **options, **extra)
    xyz = np.asarray(scan.xyz_mm, dtype=np.float64)
    shuffled = np.random.default_rng(index).permutation(xyz)
    sizes = {other.name: other.diameter_mm for other in cables}
    out = [{"method": METHODS[0], "error_mm": ransac_diameter(xyz, index) - scan.true_diameter_mm}]
    for method, given in ((METHODS[1], xyz), (METHODS[2], shuffled)):
        try:
            result = measure_cable(given, catalogue=sizes)
        except MeasureError as error:
            out.append({"method": method, "refused": str(error)})
            continue
        row = {"method": method, "error_mm": result.diameter_mm - scan.true_diameter_mm, "std_mm": result.std_mm}
        right = next(iter(result.nominal)) == cable.name
        out.append({**row, "nominal_right": right})
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
        out["coverage"] = float(np.mean(np.abs(error) < COVERAGE * std))
        out["mean_std_mm"] = float(std.mean())
        out["nominal_right"] = float(np.mean([row["nominal_right"] for row in done]))
    return out


def segmented(xyz: np.ndarray) -> tuple[float, float]:
    """Radius and arc in degrees of points that are known to be one straight cylinder's: the fit without the search.

    Normals give the direction of the axis, Kasa's circle the start of the fit that `measure_cable` makes.
    """
    near = surface(xyz, k=int(np.clip(len(xyz) // 8, 6, 24)))
    _, spread, directions = np.linalg.svd(near.normals, full_matrices=False)
    if spread[1] < 0.4 * spread[0]:  # normals within some 30 degrees of one another
        return np.nan, 0.0
    along = directions[2]
    across = frame(along)
    flat = xyz @ across.T
    middle = flat.mean(axis=0)
    system = np.concatenate([2 * (flat - middle), np.ones((len(flat), 1))], axis=1)
    circle = np.linalg.lstsq(system, np.sum((flat - middle) ** 2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(circle[2] + circle[:2] @ circle[:2]))
    ends = np.quantile(xyz @ along, [0.0, 1.0])
    center = (middle + circle[:2]) @ across
    axis = sampled(
        center + np.linspace(float(ends[0]), float(ends[1]), 30)[:, None] * along, step=float(np.ptp(ends)) / 30
    )
    fit = fit_cable(xyz, axis, radius, knot_diameters=1e6)
    return fit.radius_mm, arc_of(np.arctan2(fit.place.v, fit.place.u))


def fit4cad(folder: Path) -> dict[str, float | int]:
    """Relative error of the radius on the cylinders that show 90 degrees or more, noise of 0.5 % of the radius added."""
    rng, errors, failed, small = np.random.default_rng(0), [], 0, 0
    for one in cylinders(folder):
        xyz, radius = one.xyz, one.true.radius_mm
        try:
            found, arc = segmented(xyz + 0.005 * radius * rng.normal(size=xyz.shape))
        except (MeasureError, np.linalg.LinAlgError):
            failed += 1
            continue
        if arc < 90:
            small += 1
        else:
            errors.append(abs(found / radius - 1))
    percent = 100 * np.array(errors)
    return {
        "cylinders": len(errors),
        "failed": failed,
        "arc_below_90": small,
        "mean_percent": float(percent.mean()),
        "p90_percent": float(np.quantile(percent, 0.9)),
        "median_percent": float(np.median(percent)),
    }


REAL = (
    ("mug", "poles/pcl/table_scene_mug_stereo_textured.pcd", "m", 79.3, "PCL's tutorial prints a radius of 39.64 mm"),
    ("lamppost", "poles/pcl/lamppost.pcd", "m", None, "nothing; on a grid of 31 mm, some 60 to 120 mm by eye"),
    ("tree stem", "poles/itsme/pc_tree.las", "m", None, "nothing; it tapers"),
    ("buttressed tree", "poles/itsme/buttressed_tree_1_pc.txt.gz", "m", 301.5, "a package's diameter at one height"),
)


def real_files(folder: Path) -> Iterator[dict]:
    """What `measure_cable` says of real round things that are no cables."""
    for name, file, unit, known, source in REAL:
        path = folder / file
        if not path.is_file():
            continue
        xyz = read_points(path, unit=unit).xyz_mm
        row = {"row": "real file", "what": name, "points": len(xyz), "known_mm": known, "known_from": source}
        try:
            found = measure_cable(xyz)
        except MeasureError as error:
            yield {**row, "refused": str(error)}
            continue
        yield {
            **row,
            "diameter_mm": found.diameter_mm,
            "interval_mm": list(found.interval_mm),
            "arc_deg": found.arc_deg,
            "length_mm": found.length_mm,
            "warnings": found.warnings,
        }


def warm_seconds(points: int) -> dict:
    """Wall and processor seconds of the third measurement of a half arc, whole `measure_cable`."""
    scan = simulate_scan(catalogue()[7], n_points=points, arc_deg=180.0, key=jax.random.key(0))
    xyz, wall, used = np.asarray(scan.xyz_mm, dtype=np.float64), [], []
    for _ in range(4):
        start, cpu = time.perf_counter(), time.process_time()
        measure_cable(xyz)
        wall.append(time.perf_counter() - start)
        used.append(time.process_time() - cpu)
    return {"row": "time", "points": points, "seconds": float(np.median(wall[1:])), "cpu_s": float(np.median(used[1:]))}


def simulated(options: argparse.Namespace) -> Iterator[dict]:
    """A line for every row and method."""
    for name, scan in ROWS:
        rows = [
            row
            for index in range(options.scans)
            for row in one_scan(scan, index=index, preset=options.preset, points=options.points)
        ]
        for method in METHODS:
            yield {"row": name, "method": method, **summary([row for row in rows if row["method"] == method])}


def lines(options: argparse.Namespace) -> Iterator[dict]:
    """What was asked for."""
    if "simulated" in options.rows:
        yield from simulated(options)
    data = os.environ.get("CABLEJAX_DATA")
    if data and "fit4cad" in options.rows:
        yield {"row": "Fit4CAD", **fit4cad(Path(data) / "primitives" / "fit4cad")}
    if data and "real" in options.rows:
        yield from real_files(Path(data))
    if "time" in options.rows:
        yield warm_seconds(options.points)


def main() -> None:
    """Measure, print, and write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=13, help="scans a row (default: 13, one a size)")
    parser.add_argument("--points", type=int, default=53_135)
    parser.add_argument("--preset", default="line-laser")
    parser.add_argument("--rows", nargs="+", choices=PARTS, default=PARTS, help="default: all")
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    table = []
    for line in lines(options):
        table.append(line)
        text = (f"{key} {value:.4g}" if isinstance(value, float) else str(value) for key, value in line.items())
        print("  ".join(text), flush=True)
    if options.out:
        mine = {line["row"] for line in table}
        table = [row for row in record.earlier_rows(options.out, "summary") if row["row"] not in mine] + table
        seeds = [1000 + index for index in range(options.scans)]
        config = {"preset": options.preset, "points": options.points}
        record.write(options.out, {"summary": record.table(table, config=config)}, seeds=seeds, config=config)


if __name__ == "__main__":
    main()
