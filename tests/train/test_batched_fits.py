"""Runs trained together are the runs trained one by one."""

import numpy as np
import pytest
from flax import nnx

from cablejax.train import fit, fit_together
from tests.train.tiny import Tiny, settings, split, weights


@pytest.mark.parametrize("optimizer", ["adadelta", "sgd"])
def test_equal_to_runs_one_by_one(optimizer):
    config = settings(optimizer=optimizer, epochs=3, ema_decay=0.9, keep_best=True, schedule="cosine")
    seeds, rates = [0, 5], [0.5, 0.1]
    models = [Tiny(nnx.Rngs(seed)) for seed in (1, 2)]
    together = fit_together(models, split(), split(seed=1), config, seeds=seeds, learning_rates=rates, progress=False)
    for model, seed, rate, found in zip(models, seeds, rates, together, strict=True):
        alone = fit(
            model,
            split(),
            split(seed=1),
            settings(**(vars(config) | {"seed": seed, "learning_rate": rate})),
            progress=False,
        )
        assert found.best_epoch == alone.best_epoch
        for a, b in zip(found.history, alone.history, strict=True):
            ours, theirs = a.scalars() | {"train/seconds": 0}, b.scalars() | {"train/seconds": 0}
            assert ours == pytest.approx(theirs, rel=1e-4)
        for a, b in zip(weights(found), weights(alone), strict=True):
            # A batched product may add in another order: the last bits, a few updates on.
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


def test_lengths_and_architectures_must_agree():
    models = [Tiny(nnx.Rngs(0)), Tiny(nnx.Rngs(1))]
    with pytest.raises(ValueError, match="seed: expected 2 values, one a model, got 3"):
        fit_together(models, split(), None, settings(), seeds=[0, 1, 2])
    with pytest.raises(ValueError, match="models: expected one architecture"):
        fit_together([models[0], Tiny(nnx.Rngs(1), dropout=0.5)], split(), None, settings())
    with pytest.raises(ValueError, match="models: expected at least one"):
        fit_together([], split(), None, settings())
