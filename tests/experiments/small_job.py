"""A sweep of small jobs, one kernel on a few points, in place of an experiment's: `python -m tests.experiments.small_job -m`.

The job whose `filter.k` stands in the environment as `HELD` never ends: whoever kills the sweep knows what is done by then.
"""

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.ops import statistical_outliers
from cablejax.types import PointCloud
from experiments.harness import app
from experiments.harness.schema import Config

POINTS = 64


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Remove the outliers of a few random points."""
    if os.environ.get("HELD") == str(cfg.filter.k):
        signal.pause()
    xyz = np.random.default_rng(cfg.seed).normal(size=(POINTS, 3))
    keep = np.asarray(statistical_outliers(PointCloud.from_xyz(xyz), k=cfg.filter.k, std_ratio=1.0).keep)
    return {"remaining": int(keep.sum()), "rms_mm": float(np.sqrt(np.mean(xyz[keep] ** 2)))}


if __name__ == "__main__":
    app.main(run, experiment="table1_filtering", headline=lambda metrics: f"{metrics['remaining']} points left")
