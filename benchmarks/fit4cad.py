"""Cylinders of the CAD clouds of Fit4CAD through the whole search: `python -m benchmarks.fit4cad --out FILE.json`.

The points of each cylinder of `$CABLEJAX_DATA/primitives/fit4cad` are given to `measure_cable`, as they are and with noise of
0.5 % of the radius; what it says is held against the radius of the CAD model. Of those with 50 points, which a measurement
needs, the ones that the model shows over more than 300 degrees are counted apart: a plain fit gets them all.
"""

import argparse
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import record
from cablejax.measure import MeasureError, MeasureSettings, measure_cable
from cablejax.measure.find.cylinder import Cylinder, frame, radial
from cablejax.measure.messages import MIN_POINTS

WRONG = 0.05  # of the radius: a larger error is another cylinder
ALL_ROUND_DEG = 300.0
NOISES = (0.0, 0.005)  # of the radius
KINDS = (("all round", ALL_ROUND_DEG, 361.0), ("90 to 300 degrees", 90.0, ALL_ROUND_DEG), ("less", 0.0, 90.0))


class Primitive(NamedTuple):
    """A cylinder of a CAD cloud: where it comes from, its points `[n, 3]`, and the model's numbers."""

    name: str
    xyz: np.ndarray
    true: Cylinder

    def seen(self) -> tuple[float, float]:
        """Arc in degrees and length over the diameter that the points show of the model."""
        _, outward, along = radial(self.true, self.xyz)
        place = outward @ frame(self.true.direction).T
        angle = np.sort(np.arctan2(place[:, 1], place[:, 0]))
        gap = float(np.diff(np.append(angle, angle[0] + 2 * np.pi)).max())  # few points leave many small ones
        return 360 - float(np.degrees(gap)), float(np.ptp(along)) / (2 * self.true.radius_mm)


def cylinders(folder: Path) -> Iterator[Primitive]:
    """Every cylinder of the data set, whole files in turn."""
    number = r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?"
    for file in sorted(folder.glob("PC*_parametric.txt")):
        stem = file.name.removesuffix("_parametric.txt")
        triples = re.findall(rf"\[({number}),\s*({number}),\s*({number})\]", (folder / f"{stem}.txt").read_text())
        xyz = np.array(triples, dtype=np.float64)
        members = re.findall(r"\[([^\]]*)\]", (folder / f"{stem}_primitives.txt").read_text())
        shapes = re.findall(r"\[(\w+), \[([^\]]*)\]\]", file.read_text())
        for index, ((kind, values), rows) in enumerate(zip(shapes, members, strict=True), 1):
            if kind == "Cylinder":
                a, _, axis, center = np.array(values.split(), dtype=float).reshape(4, 3)
                points = xyz[np.array(rows.replace(",", " ").split(), dtype=int) - 1]
                true = Cylinder(center, axis / np.linalg.norm(axis), float(np.linalg.norm(a)))
                yield Primitive(f"{stem}/{index}", points, true)


def measured(one: Primitive, noise: float, seed: int) -> dict[str, Any]:
    """What the whole search says of one cylinder."""
    arc, slender = one.seen()
    diameter = 2 * one.true.radius_mm
    row: dict[str, Any] = {"cylinder": one.name, "noise": noise, "points": len(one.xyz), "diameter_mm": diameter}
    row |= {"arc_deg": arc, "length_over_diameter": slender}
    rng = np.random.default_rng(seed)
    xyz = one.xyz + noise * one.true.radius_mm * rng.normal(size=one.xyz.shape)
    start = time.perf_counter()
    try:
        found = measure_cable(xyz, settings=MeasureSettings(seed=seed))
    except MeasureError as error:
        return {**row, "verdict": "refused", "refused": str(error), "seconds": time.perf_counter() - start}
    seconds, (low, high) = time.perf_counter() - start, found.interval_mm
    error = found.diameter_mm / diameter - 1
    return {
        **row,
        "verdict": "measured" if abs(error) < WRONG else "wrong",
        "error_percent": 100 * error,
        "interval_mm": [low, high],
        "holds": low <= diameter <= high,
        "seconds": seconds,
    }


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Counts and errors by noise and by how much of the circumference the model shows."""
    out = []
    for noise in sorted({row["noise"] for row in rows}):
        for kind, low, high in KINDS:
            part = [row for row in rows if row["noise"] == noise and low <= row["arc_deg"] < high]
            told = [row for row in part if "error_percent" in row]
            right = np.array([abs(row["error_percent"]) for row in told if row["verdict"] == "measured"])
            line: dict[str, Any] = {"noise": noise, "kind": kind, "cylinders": len(part), "measured": len(right)}
            line |= {"wrong": len(told) - len(right), "refused": len(part) - len(told)}
            line |= {"holds": sum(row["holds"] for row in told)}
            if len(right):
                line |= {"median_percent": float(np.median(right)), "p90_percent": float(np.quantile(right, 0.9))}
            out.append(line)
    return out


def main() -> None:
    """Measure, print, and write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of noise and search")
    parser.add_argument(
        "--arc", type=float, default=0.0, help="least arc in degrees of the cylinders that are measured"
    )
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    folder = Path(os.environ.get("CABLEJAX_DATA", "../shared/data")) / "primitives" / "fit4cad"
    given = [one for one in cylinders(folder) if one.seen()[0] >= options.arc]
    if not given:
        raise SystemExit(f"{folder}: holds no cylinders; CABLEJAX_DATA names the folder that primitives/ lies in")
    large = [one for one in given if len(one.xyz) >= MIN_POINTS]
    rows = []
    for noise in NOISES:
        for one in large:
            rows.append(measured(one, noise, options.seed))
            row = rows[-1]
            told = f"{row['error_percent']:+.3f} %" if "error_percent" in row else row["refused"][:100]
            print(
                f"{row['cylinder']:10s} noise {noise:5.3f} {row['points']:5d} points {row['arc_deg']:3.0f} degrees, "
                f"{row['length_over_diameter']:5.2f} D long  {row['verdict']:8s} {row['seconds']:5.1f} s  {told}",
                flush=True,
            )
    for line in summary(rows):
        print("  ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in line.items()))
    if options.out:
        config = {"wrong": WRONG, "least_arc_deg": options.arc, "too_few_points": len(given) - len(large)}
        tables = {"summary": record.table(summary(rows), config=config), "cylinders": record.table(rows)}
        record.write(options.out, tables, seeds=[options.seed], config=config)


if __name__ == "__main__":
    main()
