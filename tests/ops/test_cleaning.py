"""Removal and filter on one search: the outliers of the removal, and the filter of what is left."""

import jax
import numpy as np
import pytest

from cablejax.ops import adaptive_filter, clean, statistical_outliers
from cablejax.types import PointCloud
from tests.ops.test_filters import half_cylinder

N = 300


@pytest.fixture(scope="module")
def cloud():
    points = half_cylinder(N, radius=5.0, length=10.0)
    points[:4] += np.array([[0, 35, 0], [30, 0, 0], [0, 0, 40], [-20, -20, 0]], dtype=np.float32)
    return PointCloud.from_xyz(points, capacity=N + 10)


def test_keeps_what_the_removal_keeps_and_filters_that(cloud):
    result = clean(cloud, removal_k=10, k=16, order=0)
    keep = statistical_outliers(cloud, k=10).keep
    np.testing.assert_array_equal(result.keep, keep)
    assert not np.asarray(keep)[:4].any()
    np.testing.assert_array_equal(np.asarray(result.xyz)[~np.asarray(keep)], np.asarray(cloud.xyz)[~np.asarray(keep)])
    # Points with no outlier among their 16 neighbours have the same neighbours as in a search among the kept.
    alone = np.asarray(adaptive_filter(PointCloud(cloud.xyz, keep), k=16, order=0).xyz)
    same = np.abs(np.asarray(result.xyz) - alone).max(axis=1) < 1e-6
    assert same.mean() > 0.9


def test_jit_equals_eager(cloud):
    jitted = clean(cloud, removal_k=10, k=16, order=0)
    with jax.disable_jit():
        eager = clean(cloud, removal_k=10, k=16, order=0)
    np.testing.assert_array_equal(jitted.keep, eager.keep)
    np.testing.assert_allclose(jitted.xyz, eager.xyz, atol=1e-5)


@pytest.mark.parametrize(
    ("kwargs", "message"), [({"removal_k": 1}, "removal_k: expected at least 2"), ({"k": 0}, "k: expected at least 1")]
)
def test_bad_arguments_are_named(cloud, kwargs, message):
    with pytest.raises(ValueError, match=message):
        clean(cloud, **kwargs)
