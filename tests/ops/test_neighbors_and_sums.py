"""One search that gives a filter its neighbours and a removal its sums."""

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import knn
from cablejax.ops.neighbors import distance_sums, neighbors_and_sums


@pytest.mark.parametrize("n", [3, 200, 2500])
@pytest.mark.parametrize(("k", "total_k"), [(7, 4), (4, 7)])
def test_it_gives_what_the_two_searches_give(n, k, total_k):
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(n, 3)).astype(np.float32)
    mask = rng.random(n) < 0.9
    xyz[n // 2] = np.nan
    found = neighbors_and_sums(jnp.asarray(xyz), k=k, total_k=total_k, mask=jnp.asarray(mask))
    near = knn(jnp.asarray(xyz), k=k, mask=jnp.asarray(mask))
    total, count, status = distance_sums(jnp.asarray(xyz), k=total_k, mask=jnp.asarray(mask))
    np.testing.assert_array_equal(found.neighbors, near.neighbors)
    np.testing.assert_array_equal(found.status, near.status)
    np.testing.assert_allclose(found.total, total, rtol=1e-6)
    np.testing.assert_array_equal(found.count, count)
    np.testing.assert_array_equal(found.total_status, status)
