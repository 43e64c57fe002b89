"""Quantiles by counting against NumPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops.neighbors.kth import kth_smallest
from cablejax.ops.quantile import quantile


@pytest.mark.parametrize("q", [0.0, 0.5, 0.95, 1.0])
@pytest.mark.parametrize("kind", ["spread", "ties", "zeros", "one"])
def test_equals_numpy(q, kind):
    rng = np.random.default_rng(3)
    values = np.exp(4 * rng.normal(size=100)).astype(np.float32)
    valid = rng.random(100) < 0.7
    if kind == "ties":
        values = np.round(values)
    if kind == "zeros":
        values[rng.random(100) < 0.8] = 0
    if kind == "one":
        valid = np.arange(100) == 17
    values[~valid] = np.nan
    expected = np.quantile(values[valid].astype(np.float64), q)
    np.testing.assert_allclose(quantile(jnp.asarray(values), jnp.asarray(valid), q), expected, rtol=2e-6)


def test_nothing_valid_gives_zero():
    assert quantile(jnp.ones(5), jnp.zeros(5, dtype=bool), 0.5) == 0


def test_gradient_goes_to_the_two_values_between():
    values = jnp.asarray([4.0, 1.0, 3.0, 2.0])
    np.testing.assert_allclose(jax.grad(quantile)(values, jnp.ones(4, dtype=bool), 0.5), [0, 0, 0.5, 0.5])


@pytest.mark.parametrize("coarse", [0, 13])
@pytest.mark.parametrize("most", [3, 2**31 - 1])  # many equal ones, and all that there are
def test_kth_smallest_equals_a_sort(most, coarse):
    numbers = np.random.default_rng(3).integers(0, most, size=(4, 50), endpoint=True).astype(np.int32)
    rank = np.array([0, 1, 24, 49])
    exact = np.sort(numbers, axis=1)[np.arange(4), rank]
    found = kth_smallest(jnp.asarray(numbers), jnp.asarray(rank), coarse=coarse)
    np.testing.assert_array_equal(found, exact >> coarse << coarse)
    np.testing.assert_array_equal(kth_smallest(jnp.asarray(numbers), 7), np.sort(numbers, axis=1)[:, 7])


def test_kth_smallest_of_floats_by_their_bits():
    values = np.abs(np.random.default_rng(3).normal(size=101)).astype(np.float32)
    with jax.enable_x64():
        found = kth_smallest(jax.lax.bitcast_convert_type(jnp.asarray(values), jnp.int32), 50)
    assert found.dtype == jnp.int32
    assert np.asarray(found).view(np.float32) == np.median(values)
