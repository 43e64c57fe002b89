"""Quantiles by counting against NumPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

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
