"""Tables 2 and 3: deviation from the true surface before and after the adaptive filter, by signal-to-noise ratio.

python -m experiments.table2_3_deviation -m
"""

from pathlib import Path
from typing import Any

import numpy as np

from cablejax.types import PointCloud
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.cleaning import make_cleaner, timed
from experiments.material.scans import Deviation, make_scan, signed_distance_mm


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Filter one scan; `before` and `after` are of the same points, those that outlier removal keeps."""
    scan = make_scan(cfg.scan, cfg.noise, seed=cfg.seed)
    raw = np.asarray(scan.xyz_mm)
    cleaned, timing = timed(make_cleaner(cfg.filter), PointCloud.from_xyz(raw), repeats=1)
    keep = np.asarray(cleaned.mask)[: len(raw)]  # what follows is padding
    before = Deviation.of(signed_distance_mm(scan, raw)[keep], tolerance_mm=cfg.tolerance_mm)
    signed = signed_distance_mm(scan, np.asarray(cleaned.xyz)[: len(raw)])[keep]
    after = Deviation.of(signed, tolerance_mm=cfg.tolerance_mm)
    return {
        "before": before._asdict(),
        "after": after._asdict(),
        "diameter_bias_mm": 2 * float(np.median(signed)),
        "seconds": timing.run_s,
        "compile_seconds": timing.compile_s,
    }


def headline(metrics: dict[str, Any]) -> str:
    before, after = metrics["before"], metrics["after"]
    return (
        f"std {before['std_mm']:.3f} -> {after['std_mm']:.3f} mm, mean {after['mean_mm']:+.4f} mm, "
        f"{after['within_percent']:.1f} % within"
    )


if __name__ == "__main__":
    app.main(run, experiment="table2_3_deviation", headline=headline)
