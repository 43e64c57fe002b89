"""Voxel means on the host."""

import numpy as np
import pytest

from cablejax.geometry.voxels import voxel_groups, voxel_means


def test_voxel_means_are_the_means():
    xyz = np.random.default_rng(0).uniform(-3, 3, size=(500, 3))
    means = voxel_means(xyz, 1.0)
    cells = {tuple(cell): xyz[(np.floor(xyz) == cell).all(axis=1)].mean(axis=0) for cell in np.floor(xyz)}
    expected = np.array([cells[cell] for cell in sorted(cells)])
    np.testing.assert_allclose(means, expected, atol=1e-12)


def test_groups_sum_what_they_are_given():
    xyz = np.array([[0.1, 0.0, 0.0], [1.5, 0.0, 0.0], [0.3, 0.0, 0.0]])
    groups = voxel_groups(xyz, 1.0)
    np.testing.assert_array_equal(groups.sizes(), [2.0, 1.0])
    np.testing.assert_allclose(groups.sums(np.array([1.0, 10.0, 2.0])), [3.0, 10.0])


@pytest.mark.parametrize(("size", "told"), [(0.0, "size: expected a positive number"), (1e-9, "size: expected larger")])
def test_sizes_that_make_no_grid_are_refused(size, told):
    with pytest.raises(ValueError, match=told):
        voxel_means(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), size)
