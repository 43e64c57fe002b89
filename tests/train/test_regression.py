"""The regression head: a diameter with its standard deviation, trained beside the classes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.nets.diameter import DiameterHead, SizeEstimate
from cablejax.train import evaluate, fit
from cablejax.train.losses import gaussian_nll
from cablejax.train.metrics import diameter_score
from tests.train.tiny import Tiny, settings, split


class Sized(NamedTuple):
    xyz: np.ndarray
    mask: np.ndarray
    label: np.ndarray
    diameter_mm: np.ndarray


class TinySized(Tiny):
    """`Tiny` with a regression head on its pooled feature, whose size is the diameter's."""

    def __init__(self, rngs):
        super().__init__(rngs, dropout=0.0)
        self.diameter = DiameterHead(3, rngs=rngs)

    def with_diameter(self, xyz, mask):
        pooled = jnp.sqrt(jnp.mean(xyz**2, axis=1, where=mask[..., None]))
        return SizeEstimate(self(xyz, mask), *self.diameter(pooled))


def sized(clouds=96, seed=0):
    plain = split(clouds, seed)
    exact = np.sqrt((plain.xyz**2).mean(axis=(1, 2)))
    noise = np.random.default_rng(seed).normal(0, 0.5, clouds)
    return Sized(*plain, np.asarray(30 + 4 * exact + noise, np.float32))


@pytest.fixture(scope="module")
def trained():
    return fit(TinySized(nnx.Rngs(0)), sized(), sized(48, seed=1), settings(epochs=60), progress=False)


def test_diameter_and_its_deviation_are_learnt_beside_the_classes(trained):
    found = evaluate(trained.model, sized(96, seed=2))
    assert found.overall > 0.8
    assert found.diameter is not None
    spread = np.std(sized(96, seed=2).diameter_mm)
    # 0.5 mm of noise and a linear head on the coordinates' roots of mean squares; knowing nothing leaves the spread, 3.5.
    assert found.diameter.rmse_mm < 0.35 * spread
    assert 0.85 <= found.diameter.coverage <= 1.0


def test_every_epoch_records_it(trained):
    last = trained.history[-1]
    assert last.validation_rmse_mm < trained.history[0].validation_rmse_mm
    assert last.scalars()["validation/coverage"] == last.validation_coverage


def test_clouds_without_diameters_are_refused():
    with pytest.raises(ValueError, match="diameter_mm"):
        fit(TinySized(nnx.Rngs(0)), split(), None, settings(epochs=1), progress=False)


def test_likelihood_equals_the_gaussian_density():
    rng = np.random.default_rng(0)
    mean, std, target = rng.normal(size=5), rng.uniform(0.1, 2, 5), rng.normal(size=5)
    density = np.exp(-((target - mean) ** 2) / (2 * std**2)) / np.sqrt(2 * np.pi * std**2)
    found = gaussian_nll(*(jnp.asarray(each, jnp.float32) for each in (mean, std, target)))
    np.testing.assert_allclose(found + 0.5 * np.log(2 * np.pi), -np.log(density), rtol=1e-5, atol=1e-5)


def test_coverage_of_right_deviations_is_95_percent():
    rng = np.random.default_rng(0)
    std = rng.uniform(0.1, 1.0, 20_000)
    found = diameter_score(30 + rng.normal(0, std), std, np.full(20_000, 30.0))
    assert abs(found.coverage - 0.95) < 0.005  # three standard deviations of a share of 20,000
    assert found.rmse_mm == pytest.approx(np.sqrt(np.mean(std**2)), rel=0.03)
