"""One search that gives a filter its neighbours and a removal its sums."""

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import knn
from cablejax.ops.neighbors import distance_sums, neighbors_and_sums
from cablejax.ops.neighbors.request import BRUTE_POINTS
from cablejax.types import Status
from tests.reference import neighbors as reference


def cloud(n):
    """Random points, one of them not finite, and a mask."""
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(n, 3)).astype(np.float32)
    mask = rng.random(n) < 0.9
    xyz[n // 2] = np.nan
    return jnp.asarray(xyz), jnp.asarray(mask)


@pytest.mark.parametrize("n", [3, 200])
@pytest.mark.parametrize(("k", "total_k"), [(7, 4), (4, 7)])
def test_it_gives_what_the_two_searches_give(n, k, total_k):
    xyz, mask = cloud(n)
    found = neighbors_and_sums(xyz, k=k, total_k=total_k, mask=mask)
    near = knn(xyz, k=k, mask=mask)
    total, count, status = distance_sums(xyz, k=total_k, mask=mask)
    np.testing.assert_array_equal(found.neighbors, near.neighbors)
    np.testing.assert_array_equal(found.status, near.status)
    np.testing.assert_allclose(found.total, total, rtol=1e-6)
    np.testing.assert_array_equal(found.count, count)
    np.testing.assert_array_equal(found.total_status, status)


@pytest.mark.parametrize(("k", "total_k"), [(7, 4), (4, 7)])
def test_by_the_tree_it_gives_what_the_reference_gives(k, total_k):
    n = BRUTE_POINTS + 452
    xyz, mask = cloud(n)
    found = neighbors_and_sums(xyz, k=k, total_k=total_k, mask=mask)
    usable = np.asarray(mask) & (np.arange(n) != n // 2)
    _, sq_dist = reference.knn(xyz, 7, mask=usable)
    exact, rows = np.asarray(xyz, np.float64)[usable], np.asarray(found.neighbors)[usable]
    assert usable[rows].all()
    assert (np.sort(rows, axis=1)[:, 1:] > np.sort(rows, axis=1)[:, :-1]).all()  # nobody twice
    measured = ((np.asarray(xyz, np.float64)[rows] - exact[:, None]) ** 2).sum(axis=2)
    np.testing.assert_allclose(measured, sq_dist[usable, :k], rtol=1e-5)  # of two almost as near float32 takes either
    np.testing.assert_allclose(found.total[usable], np.sqrt(sq_dist[usable, :total_k]).sum(axis=1), rtol=1e-5)
    np.testing.assert_array_equal(found.count, np.where(usable, total_k, 0))
    odd = np.where(np.arange(n) == n // 2, int(Status.NOT_FINITE), 0) * np.asarray(mask)
    np.testing.assert_array_equal(found.status, odd)
    np.testing.assert_array_equal(found.total_status, odd)
    assert (np.asarray(found.neighbors)[~usable] == -1).all()
    assert not np.asarray(found.total)[~usable].any()
