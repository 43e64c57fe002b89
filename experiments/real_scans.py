"""The diameter of real scans: round things from public test data, with what is known of them.

CABLEJAX_DATA=... python -m experiments.real_scans [--out results]

None of them is a cable, and none has a diameter by calliper. The committed results/real_scans.json is of all four.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.io import provenance, read_points, write_json
from cablejax.measure import MeasureError, measure_cable
from experiments import ROOT
from experiments.revision import code_revision


@dataclass(frozen=True)
class RealScan:
    """A file and what is known of the thing in it.

    Attributes:
        file: Path below the data folder's `poles`.
        what: The thing and the scanner.
        known: What another source says of its diameter.
    """

    file: str
    what: str
    known: str


SCANS = (
    RealScan("pcl/table_scene_mug_stereo_textured.pcd", "mug on a table, stereo camera",
             "79.3 mm, by PCL's cylinder tutorial"),
    RealScan("itsme/buttressed_tree_1_pc.txt.gz", "stem of a buttressed tree, terrestrial laser",
             "302 mm at one height, by the ITSMe package"),
    RealScan("itsme/pc_tree.las", "tree stem, terrestrial laser", "nothing"),
    RealScan("pcl/lamppost.pcd", "lamppost with signs, on a grid of 31 mm", "60 to 120 mm, by eye"),
)  # fmt: skip


def measured(scan: RealScan, folder: Path) -> dict[str, Any]:
    """One row of the results: the measurement, or why there is none."""
    xyz = np.asarray(read_points(folder / scan.file, unit="m").xyz_mm)
    row: dict[str, Any] = {"file": scan.file, "what": scan.what, "known": scan.known, "points": len(xyz)}
    start = time.perf_counter()
    try:
        found = measure_cable(xyz)
        row |= {
            "diameter_mm": float(found.diameter_mm),
            "interval_mm": [float(end) for end in found.interval_mm],
            "arc_deg": float(found.arc_deg),
            "length_mm": float(found.length_mm),
            "warnings": list(found.warnings),
        }
    except MeasureError as error:
        row["error"] = str(error)
    return row | {"seconds": round(time.perf_counter() - start, 2)}


def main() -> None:
    """Measure every file and write `<out>/real_scans.json`."""
    parser = argparse.ArgumentParser(prog="python -m experiments.real_scans", description="Measure real scans.")
    parser.add_argument("--out", type=Path, default=Path("results"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    folder = Path(os.environ.get("CABLEJAX_DATA", ROOT.parent / "shared" / "data")) / "poles"
    if not folder.is_dir():
        print(f"error: CABLEJAX_DATA: expected a folder with poles/, looked for {folder}", file=sys.stderr)
        sys.exit(2)
    rows = []
    for scan in SCANS:
        rows.append(measured(scan, folder))
        told = rows[-1].get("error") or "{diameter_mm:.1f} mm".format(**rows[-1])
        print(f"{scan.what}: {told} ({rows[-1]['seconds']:.1f} s)", flush=True)
    content = {
        "experiment": "real_scans",
        "code_revision": code_revision(),
        "rows": rows,
        "provenance": {key: value for key, value in provenance(seeds=[]).items() if key != "git"},
    }
    write_json(options.out / "real_scans.json", content)
    print(options.out / "real_scans.json")


if __name__ == "__main__":
    main()
