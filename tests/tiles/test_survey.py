"""What is found out about a file before it is cut into tiles."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.tiles.survey import BLOCK, SAMPLE, typical_reach


@pytest.mark.parametrize("order", ["along", "shuffled"])
@pytest.mark.parametrize("shift", [0.0, 5000.0])
def test_the_reach_is_that_of_a_search_over_all_points(order, shift):
    """Whether blocks of rows lie apart, and are left out, or not; points without a place count for nothing."""
    rng = np.random.default_rng(0)
    xyz = (rng.normal(0, [300, 10, 10], (4 * BLOCK + 7, 3)) + shift).astype(np.float32)
    xyz = xyz[np.argsort(xyz[:, 0])] if order == "along" else xyz
    xyz[::97] = np.nan
    xyz[BLOCK : 2 * BLOCK] = np.nan
    sample = xyz[np.linspace(0, len(xyz) - 1, SAMPLE).astype(int)]
    held, queries = (each[np.isfinite(each).all(axis=1)].astype(np.float64) for each in (xyz, sample))
    expected = np.quantile(cKDTree(held).query(queries, k=41)[0][:, -1], 0.95)
    assert typical_reach(xyz, 40) == pytest.approx(expected, rel=1e-4)
