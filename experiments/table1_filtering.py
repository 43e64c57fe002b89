"""Table 1: what four filters leave of a noisy scan, in what time, and whether it was the right points.

python -m experiments.table1_filtering -m
python -m experiments.table1_filtering -m experiment=table1_outliers   # shares of outliers up to those that the paper removes
python -m experiments.table1_filtering -m experiment=table1_noise      # noise strong enough for its kinds to differ
"""

from pathlib import Path
from typing import Any

import numpy as np

from cablejax.types import PointCloud
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.cleaning import make_cleaner, timed
from experiments.material.scans import make_scan, signed_distance_mm


def removal_scores(keep: np.ndarray, is_outlier: np.ndarray) -> dict[str, float]:
    """Precision, recall and F1 of removing the known outliers; 0 where nothing was removed or to be found."""
    hits = int((~keep & is_outlier).sum())
    precision = hits / max(1, int((~keep).sum()))
    recall = hits / max(1, int(is_outlier.sum()))
    f1 = 2 * precision * recall / (precision + recall) if hits else 0.0
    return {"precision": precision, "recall": recall, "f1": f1}


FAR_MM = 1.5  # impulses that left the surface by more than some four times the scan's own spread


def impulses_removed(keep: np.ndarray, is_far_impulse: np.ndarray) -> dict[str, float]:
    """Share of the points that impulsive noise threw far off which were removed; nothing where there are none."""
    return {"impulses_removed": float((~keep)[is_far_impulse].mean())} if is_far_impulse.any() else {}


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Clean one scan with one filter; every figure is of the points that remain."""
    scan = make_scan(cfg.scan, cfg.noise, seed=cfg.seed)
    cleaned, timing = timed(
        make_cleaner(cfg.filter),
        PointCloud.from_xyz(scan.xyz_mm),
        repeats=cfg.timing_repeats,
    )
    rows = len(scan.xyz_mm)  # what follows is padding
    keep = np.asarray(cleaned.mask)[:rows]
    signed = signed_distance_mm(scan, np.asarray(cleaned.xyz)[:rows])[keep]
    return {
        "points": int(keep.size),
        "remaining": int(keep.sum()),
        "seconds": timing.run_s,
        "compile_seconds": timing.compile_s,
        **removal_scores(keep, np.asarray(scan.is_outlier)),
        **impulses_removed(keep, np.asarray(scan.is_impulse) & (np.abs(np.asarray(scan.signed_distance_mm)) > FAR_MM)),
        "rms_mm": float(np.sqrt(np.mean(signed**2))),
        # The median, so that a few outliers left behind do not decide it.
        "diameter_bias_mm": 2 * float(np.median(signed)),
    }


def headline(metrics: dict[str, Any]) -> str:
    return f"{metrics['remaining']:,} points left, F1 {metrics['f1']:.3f}, {1000 * metrics['seconds']:.0f} ms"


if __name__ == "__main__":
    app.main(run, experiment="table1_filtering", headline=headline)
