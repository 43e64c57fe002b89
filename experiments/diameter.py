"""The diameter of a simulated scan, from its raw and from its filtered points, and a view of both.

python -m experiments.diameter -m
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.geometry.robust import robust_std
from cablejax.measure import measure_cable
from cablejax.report import thin
from cablejax.simulate import Scan, catalogue
from cablejax.types import PointCloud
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.cleaning import make_cleaner
from experiments.material.scans import make_scan, section_coordinates_mm, signed_distance_mm

VIEW_POINTS = 5000
SLICE_MM = 4.0
NOT_KEPT = (
    "axis_mm",
    "keep",
    "deviation_mm",
    "sections",
)  # one number per point or section: too much for a results file


def measure(xyz_mm: np.ndarray) -> tuple[dict[str, Any], float]:
    """Measure a cloud against the 8.7/15 kV catalogue; the result in JSON's terms, and the seconds it took."""
    start = time.perf_counter()
    measured = measure_cable(xyz_mm, catalogue={cable.name: cable.diameter_mm for cable in catalogue()})
    seconds = time.perf_counter() - start
    return {key: value for key, value in measured.to_dict().items() if key not in NOT_KEPT}, seconds


def view(scan: Scan, clouds: dict[str, np.ndarray]) -> dict[str, Any]:
    """Thinned points with their deviation, and a slice across the middle, rounded to a micrometre."""
    result: dict[str, Any] = {"radius_mm": float(scan.true_diameter_mm) / 2, "slice_mm": SLICE_MM, "section": {}}
    for name, xyz in clouds.items():
        signed = signed_distance_mm(scan, xyz)
        rows = thin(len(xyz), most=VIEW_POINTS)
        result[name] = {"xyz_mm": np.round(xyz[rows], 3).tolist(), "deviation_mm": np.round(signed[rows], 3).tolist()}
        across = section_coordinates_mm(scan, xyz)
        result["section"][name] = np.round(across[np.abs(across[:, 2]) < SLICE_MM / 2, :2], 3).tolist()
        result["scale_mm"] = result.get("scale_mm", robust_std(signed))
    return result


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Measure one scan before and after filtering."""
    scan = make_scan(cfg.scan, cfg.noise, seed=cfg.seed)
    raw = np.asarray(scan.xyz_mm)
    cleaned = make_cleaner(cfg.filter)(PointCloud.from_xyz(raw))
    filtered = np.asarray(cleaned.xyz)[np.asarray(cleaned.mask)]
    metrics: dict[str, Any] = {"true_diameter_mm": float(scan.true_diameter_mm)}
    for name, xyz in (("raw", raw), ("filtered", filtered)):
        metrics[name], metrics[f"{name}_seconds"] = measure(xyz)
    if cfg.seed == 0:
        metrics["view"] = view(scan, {"raw": raw, "filtered": filtered})
    return metrics


def headline(metrics: dict[str, Any]) -> str:
    low, high = metrics["raw"]["interval_mm"]
    return (
        f"diameter {metrics['raw']['diameter_mm']:.3f} mm, 95 % interval {low:.3f} - {high:.3f}, "
        f"true {metrics['true_diameter_mm']:.3f}"
    )


if __name__ == "__main__":
    app.main(run, experiment="diameter", headline=headline)
