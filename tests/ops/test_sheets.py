"""Neighbours through a thin wall do not count; those of one noisy sheet do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import adaptive_filter
from cablejax.ops.moments import local_noise
from cablejax.ops.sheets import own_sheet
from cablejax.types import PointCloud

SIGMA, K = 0.02, 100


def plate(apart, n=4000, seed=0):
    """Two sides of a plate `apart` deviations of noise apart: truth, noisy points, and on which side each is."""
    rng = np.random.default_rng(seed)
    upper = rng.random(n) < 0.5
    half = np.sqrt(n / 10_000)
    truth = np.c_[rng.uniform(-half, half, (n, 2)), np.where(upper, 0.5, -0.5) * apart * SIGMA]
    return truth, truth + rng.normal(size=truth.shape) * SIGMA, upper


def kept_neighbors(xyz, rows):
    """Neighbours of some rows, and which of them are left."""
    near = cKDTree(xyz).query(xyz[rows], k=K)[1]
    points, centre, slots = (jnp.asarray(a.T) for a in (np.float32(xyz), np.float32(xyz[rows]), np.int32(near)))
    found = jax.jit(lambda *cloud: own_sheet(*cloud, local_noise(*cloud)))(points, centre, slots)
    kept = np.asarray(found).T
    assert ((kept == near) | (kept == -1)).all()
    return near, kept >= 0


def test_most_of_the_other_side_is_left_out():
    truth, xyz, upper = plate(5.0)
    inside = np.nonzero(np.abs(truth[:, :2]).max(axis=1) < 0.4)[0][:300]
    near, kept = kept_neighbors(xyz, inside)
    same = upper[near] == upper[inside][:, None]
    there = (~same).sum(axis=1) >= 15  # enough of the other side to be seen
    assert there.sum() > 100
    assert kept[there][same[there]].mean() > 0.95
    assert kept[there][~same[there]].mean() < 0.65  # a ball higher than wide is parted along the wrong plane


def test_one_noisy_sheet_is_not_parted():
    rng = np.random.default_rng(1)
    xyz = np.c_[rng.uniform(-0.6, 0.6, (4000, 2)), np.zeros(4000)] + rng.normal(size=(4000, 3)) * SIGMA
    assert kept_neighbors(xyz, np.arange(300))[1].mean() > 0.98


@pytest.mark.parametrize("apart", [4.0, 6.0])
def test_no_thin_plate_comes_out_worse_than_it_went_in(apart):
    truth, xyz, _ = plate(apart, n=2000)

    def chamfer(cloud):
        return sum((cKDTree(a).query(b)[0] ** 2).mean() for a, b in ((truth, cloud), (cloud, truth)))

    cleaned = np.asarray(adaptive_filter(PointCloud.from_xyz(xyz.astype(np.float32)), order=2).xyz)[: len(xyz)]
    assert chamfer(cleaned) < 0.98 * chamfer(xyz)
