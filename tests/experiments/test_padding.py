"""Clouds are padded to few sizes, and no number of an experiment knows of the padding."""

import numpy as np
import pytest

from cablejax.types import capacity_for
from experiments import table1_filtering, table2_3_deviation
from tests.experiments.harness.test_configuration import compose_config

POINTS = 1900


@pytest.mark.parametrize("task", [table1_filtering, table2_3_deviation], ids=lambda task: task.__name__.split(".")[1])
def test_padding_counts_for_nothing(task, tmp_path):
    assert capacity_for(POINTS) > POINTS
    name = task.__name__.split(".")[1]
    config = compose_config(f"experiment={name}", "size=smoke", "filter=statistical", f"scan.n_points={POINTS}")
    metrics = task.run(config, tmp_path)
    if task is table1_filtering:
        assert metrics["points"] == POINTS
        assert metrics["remaining"] < POINTS
        assert metrics["recall"] > 0.5
        assert metrics["rms_mm"] < 1.0
    else:  # removal alone moves nothing
        assert metrics["before"] == metrics["after"]
        assert np.isfinite(metrics["before"]["std_mm"])
