"""What a network's part labels do for the measurement: cables among other things, with and without.

    python -m benchmarks.parts --checkpoint RUN --out results/benchmarks/parts.json

RUN is the folder of a finished run of `experiments.parts`. Each scene is scanned by three scanners over half and over all of
the circumference, each time another cable size and another random key, none of those the network was trained on. Each scan is
measured as it is, with the network's labels, and with the true ones.
"""

import argparse
import time
from typing import Any

import jax
import numpy as np
from flax import nnx

from benchmarks import record
from cablejax.cli.checkpoint import read_run, restored
from cablejax.geometry.robust import COVERAGE
from cablejax.measure import MeasureError, measure_cable
from cablejax.nets import PartNetwork, label_parts
from cablejax.simulate import catalogue, simulate_scan
from cablejax.simulate.part_clouds import GROUP

SCENES = (
    "bend", "bend+clamp", "bend+wall", "bend+support", "two-cables", "trefoil", "bend+tray", "bend+clamp+tray", "joint",
    "joint-stepped+wall", "stress-cone", "termination", "joint+tray",
)  # fmt: skip
PRESETS = ("line-laser", "structured-light", "paper-floor")
ARCS = (180.0, 360.0)
FIRST_KEY = 700_000
RIGHT = 0.02  # of the diameter


def measured(xyz: np.ndarray, truth: float, on_cable: np.ndarray | None) -> dict[str, Any]:
    """Error and claim of one measurement, or the reason why there is none."""
    try:
        result = measure_cable(xyz, on_cable=on_cable)
    except MeasureError as error:
        return {"refused": str(error)}
    return {"error_mm": result.diameter_mm - truth, "std_mm": result.std_mm, "relative": result.diameter_mm / truth - 1}


def one_scan(index: int, network: nnx.Module, clouds: dict[str, Any], points: int) -> dict[str, Any]:
    """The three measurements of one scan, and how well its points were labelled."""
    scene, preset = SCENES[index % len(SCENES)], PRESETS[index // len(SCENES) % len(PRESETS)]
    arc = ARCS[index // (len(SCENES) * len(PRESETS)) % 2]
    cables = catalogue()
    cable = cables[(5 * index + index // len(SCENES)) % len(cables)]
    scan = simulate_scan(
        cable, n_points=points, preset=preset, shape=scene, arc_deg=arc, length_mm=13.5 * cable.diameter_mm,
        key=jax.random.key(FIRST_KEY + index),
    )  # fmt: skip
    xyz, truth = np.asarray(scan.xyz_mm, np.float64), GROUP[np.asarray(scan.part)]
    start = time.perf_counter()
    found = label_parts(network, xyz, **clouds).part
    seconds = time.perf_counter() - start
    cable_found, cable_true = found == 0, truth == 0
    return {
        "scene": scene, "preset": preset, "arc_deg": arc, "diameter_mm": cable.diameter_mm, "label_seconds": seconds,
        "labelled_right": float(np.mean(found == truth)),
        "cable_iou": float(np.sum(cable_found & cable_true) / np.sum(cable_found | cable_true)),
        "without": measured(xyz, cable.diameter_mm, None),
        "network": measured(xyz, cable.diameter_mm, cable_found),
        "truth": measured(xyz, cable.diameter_mm, cable_true),
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
    parser.add_argument("--checkpoint", required=True, metavar="RUN")
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--scans", type=int, default=len(SCENES) * len(PRESETS) * len(ARCS))
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    run = read_run(options.checkpoint, trained="network that labels parts", by="experiments.parts", holds="parts")
    config = run["config"]
    network = restored(
        options.checkpoint,
        PartNetwork(len(run["metrics"]["parts"]), rngs=nnx.Rngs(0), **config["model"]["options"]),
    )
    clouds = {name: config["parts"][name] for name in ("n_points", "ball_mm")}
    rows = []
    for index in range(options.scans):
        rows.append(one_scan(index, network, clouds, options.points))
        row = rows[-1]
        told = ", ".join(
            f"{way} {row[way]['error_mm']:+.3f} mm" if "error_mm" in row[way] else f"{way} refused"
            for way in ("without", "network", "truth")
        )
        print(f"{index + 1} of {options.scans}: {row['scene']}, {row['preset']}, {row['arc_deg']:g} degrees: "
              f"{100 * row['cable_iou']:.0f} % IoU, {told}", flush=True)  # fmt: skip
    table = [
        {"scene": scene, "way": way, **summary([row for row in rows if scene in ("all", row["scene"])], way)}
        for scene in ("all", *dict.fromkeys(row["scene"] for row in rows))
        for way in ("without", "network", "truth")
    ]
    for line in table:
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in line.items()))
    if options.out:
        used = {
            "points": options.points,
            "network": run["code_revision"],
            "training": run["metrics"]["test_overall"],
        }
        found = {"summary": record.table(table, config=used), "scans": record.table(rows)}
        record.write(options.out, found, seeds=[FIRST_KEY], config=used)


if __name__ == "__main__":
    main()
