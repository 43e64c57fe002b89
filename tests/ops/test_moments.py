"""Masked and local moments, eqs. (2) and (3), against NumPy float64."""

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import local_moments, masked_covariance, masked_mean, masked_variance


@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_masked_moments_equal_numpy(offset):
    rng = np.random.default_rng(0)
    values = (rng.normal(size=(4, 30, 3)) + offset).astype(np.float32)
    mask = rng.random((4, 30)) < 0.5
    for i in range(4):
        valid = values[i][mask[i]].astype(np.float64)
        # Offsets from one of the points keep their digits: the mean is right to the last place of the coordinates.
        np.testing.assert_allclose(
            masked_mean(jnp.asarray(values), jnp.asarray(mask))[i], valid.mean(0), rtol=1e-6, atol=1e-6
        )
        centred = valid - valid.mean(0)
        tolerance = {"rtol": 1e-4, "atol": 1e-5 + 1e-7 * offset}
        np.testing.assert_allclose(
            masked_variance(jnp.asarray(values), jnp.asarray(mask))[i], (centred**2).sum(1).mean(), **tolerance
        )
        np.testing.assert_allclose(
            masked_covariance(jnp.asarray(values), jnp.asarray(mask))[i],
            centred.T @ centred / len(centred),
            **tolerance,
        )


def test_no_valid_row_gives_zeros():
    values, mask = jnp.full((5, 3), jnp.nan), jnp.zeros(5, dtype=bool)
    assert not np.asarray(masked_mean(values, mask)).any()
    assert float(masked_variance(values, mask)) == 0
    assert not np.asarray(masked_covariance(values, mask)).any()


def test_local_moments_leave_out_missing_neighbours():
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(20, 3)).astype(np.float32)
    neighbors = rng.integers(-1, 20, (20, 6))
    moments = local_moments(jnp.asarray(xyz), jnp.asarray(neighbors))
    for i in range(20):
        near = xyz[neighbors[i][neighbors[i] >= 0]].astype(np.float64)
        assert int(moments.found[i]) == len(near)
        np.testing.assert_allclose(moments.mean[i], near.mean(0), rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(moments.covariance[i], np.cov(near.T, bias=True), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(moments.variance[i], np.trace(np.cov(near.T, bias=True)), rtol=1e-5)


def test_bad_mask_is_named():
    with pytest.raises(ValueError, match=r"mask: expected shape \[5\], got \[4\]"):
        masked_mean(jnp.zeros((5, 3)), jnp.zeros(4, dtype=bool))
