"""The cylinder fit that stands beside every network's accuracy."""

import numpy as np
import pytest

from cablejax.simulate import DatasetConfig, make_split
from experiments.material.baseline import baseline, fitted_diameters


@pytest.fixture(scope="module")
def config() -> DatasetConfig:
    return DatasetConfig(sizes_mm2=(25, 150, 630), n_points=128, clouds_per_class=4)


@pytest.fixture(scope="module")
def split(config: DatasetConfig):
    return make_split(config, "validation")


def test_sizes_far_apart_are_told_by_their_diameter(config, split):
    error = fitted_diameters(split) - np.asarray(split.diameter_mm)
    assert np.median(np.abs(error)) < 0.2  # noise 0.1 mm, 128 points, arcs from 180 degrees
    assert baseline(split, config.diameters_mm) == {"baseline_overall": 1.0, "baseline_class_average": 1.0}


def test_a_cloud_without_a_fit_counts_as_wrong(config, split):
    mask = np.asarray(split.mask).copy()
    mask[0] = False
    found = baseline(split._replace(mask=mask), config.diameters_mm)
    assert found["baseline_overall"] == pytest.approx(11 / 12)
    assert found["baseline_class_average"] == pytest.approx((3 / 4 + 1 + 1) / 3)
