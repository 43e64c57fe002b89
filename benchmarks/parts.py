"""What a network's part labels do for the measurement: cables among other things, with and without.

    python -m benchmarks.parts --out results/benchmarks/parts.json

Each scene is scanned by three scanners over half and over all of the circumference, each time another cable size and another
random key, none of those the network was trained on. Each scan is measured without labels, as `cablejax measure` does by default
("auto": with labels where other things lie beside the cable, told where they do not confirm the search), on the points that are
labelled as a cable's alone ("network"), and on the true ones. `--first-key` simulates other scans, on which rules may be chosen.
"""

import argparse
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks import record
from cablejax.geometry.robust import COVERAGE
from cablejax.measure import CableMeasurement, MeasureError, PointLabels, measure_cable, measure_labelled
from cablejax.nets import Pretrained, label_parts, load_pretrained
from cablejax.simulate import PARTS, catalogue, simulate_scan
from cablejax.simulate.part_clouds import GROUP

SCENES = (
    "bend", "bend+clamp", "bend+wall", "bend+support", "two-cables", "trefoil", "bend+tray", "bend+clamp+tray", "joint",
    "joint-stepped+wall", "stress-cone", "termination", "joint+tray",
)  # fmt: skip
PRESETS = ("line-laser", "structured-light", "paper-floor")
ARCS = (180.0, 360.0)
FIRST_KEY = 700_000
RIGHT = 0.02  # of the diameter
WAYS = ("without", "auto", "network", "truth")


def measured(measure: Callable[[], CableMeasurement], truth: float) -> dict[str, Any]:
    """Error and claim of one measurement, or the reason why there is none."""
    try:
        result = measure()
    except MeasureError as error:
        return {"refused": str(error)}
    return {"error_mm": result.diameter_mm - truth, "std_mm": result.std_mm, "relative": result.diameter_mm / truth - 1}


def one_scan(index: int, labeller: Pretrained, options: argparse.Namespace) -> dict[str, Any]:
    """The measurements of one scan, and how well its points were labelled."""
    scene, preset = SCENES[index % len(SCENES)], PRESETS[index // len(SCENES) % len(PRESETS)]
    arc = ARCS[index // (len(SCENES) * len(PRESETS)) % 2]
    cables = catalogue()
    cable = cables[(5 * index + index // len(SCENES)) % len(cables)]
    scan = simulate_scan(
        cable, n_points=options.points, preset=preset, shape=scene, arc_deg=arc, length_mm=13.5 * cable.diameter_mm,
        key=jax.random.key(options.first_key + index),
    )  # fmt: skip
    xyz, truth = np.asarray(scan.xyz_mm, np.float64), GROUP[np.asarray(scan.part)]
    clouds = labeller.card["clouds"]
    found = label_parts(labeller.network, xyz, n_points=clouds["n_points"], ball_mm=clouds["ball_mm"]).part
    cable_found, cable_true = found == PARTS.index("cable"), truth == PARTS.index("cable")
    labels = PointLabels(cable_found, found == PARTS.index("accessory"), tuple(clouds["diameter_mm"]))
    diameter = cable.diameter_mm
    ways = {
        "without": lambda: measure_cable(xyz),
        "auto": lambda: measure_labelled(xyz, lambda: labels).result,
        "network": lambda: measure_cable(xyz, on_cable=cable_found),
        "truth": lambda: measure_cable(xyz, on_cable=cable_true),
    }
    return {
        "scene": scene, "preset": preset, "arc_deg": arc, "diameter_mm": diameter,
        "labelled_right": float(np.mean(found == truth)),
        "cable_iou": float(np.sum(cable_found & cable_true) / np.sum(cable_found | cable_true)),
        **{way: measured(ways[way], diameter) for way in options.ways},
    }  # fmt: skip


def summary(rows: list[dict[str, Any]], way: str) -> dict[str, float | int | None]:
    """How many scans were measured, how many to `RIGHT`, how many intervals held the truth, and the middle error."""
    done = [row[way] for row in rows if "error_mm" in row[way]]
    out: dict[str, float | int | None] = {"scans": len(rows), "refused": len(rows) - len(done)}
    error = np.array([abs(one["error_mm"]) for one in done])
    out["right"] = int(sum(abs(one["relative"]) < RIGHT for one in done))
    out["holds"] = int(sum(abs(one["error_mm"]) < COVERAGE * one["std_mm"] for one in done))
    out["median_mm"] = float(np.median(error)) if len(error) else None
    return out


def main() -> None:
    """Measure, print, and write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", default="parts", help="of the package (default: parts)")
    parser.add_argument("--ways", nargs="+", default=WAYS, choices=WAYS, help="of measuring (default: all)")
    parser.add_argument("--first-key", type=int, default=FIRST_KEY)
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--scans", type=int, default=len(SCENES) * len(PRESETS) * len(ARCS))
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    labeller = load_pretrained(options.network)
    rows = []
    for index in range(options.scans):
        rows.append(one_scan(index, labeller, options))
        row = rows[-1]
        told = ", ".join(
            f"{way} {row[way]['error_mm']:+.3f} mm" if "error_mm" in row[way] else f"{way} refused"
            for way in options.ways
        )
        print(f"{index + 1} of {options.scans}: {row['scene']}, {row['preset']}, {row['arc_deg']:g} degrees: "
              f"{100 * row['cable_iou']:.0f} % IoU, {told}", flush=True)  # fmt: skip
    table = [
        {"scene": scene, "way": way, **summary([row for row in rows if scene in ("all", row["scene"])], way)}
        for scene in ("all", *dict.fromkeys(row["scene"] for row in rows))
        for way in options.ways
    ]
    for line in table:
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in line.items()))
    if options.out:
        used = {
            "points": options.points,
            "network": labeller.card["name"],
            "sha256": labeller.card["sha256"],
        }
        found = {"summary": record.table(table, config=used), "scans": record.table(rows)}
        record.write(options.out, found, seeds=[options.first_key], config=used)


if __name__ == "__main__":
    main()
