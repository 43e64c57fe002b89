"""Weights from another run, and parts that stay as they are."""

import numpy as np
import pytest
from flax import nnx

from cablejax.train import fit, initialise_from
from tests.train.tiny import Tiny, settings, split


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pretrained")
    config = settings(epochs=2, keep_best=True)
    return folder, fit(Tiny(nnx.Rngs(0)), split(), split(seed=1), config, folder=folder, progress=False)


def test_takes_the_best_weights_and_statistics_and_names_what_does_not_fit(trained):
    folder, result = trained
    other = Tiny(nnx.Rngs(5))
    other.out = nnx.Linear(16, 7, rngs=nnx.Rngs(6))  # other classes
    model, kept = initialise_from(other, folder)
    np.testing.assert_array_equal(model.hidden.kernel[...], result.model.hidden.kernel[...])
    np.testing.assert_array_equal(model.norm.mean[...], result.model.norm.mean[...])
    np.testing.assert_array_equal(model.out.kernel[...], other.out.kernel[...])
    assert sorted(kept) == ["out.bias", "out.kernel"]
    assert float(np.abs(other.hidden.kernel[...] - model.hidden.kernel[...]).max()) > 0  # the one given is not changed


def test_frozen_parts_stay(trained):
    model, _ = initialise_from(Tiny(nnx.Rngs(5)), trained[0])
    config = settings(epochs=1, frozen=("hidden", "norm.scale"))
    tuned = fit(model, split(seed=3), None, config, progress=False).model
    for part in ("kernel", "bias"):
        np.testing.assert_array_equal(getattr(tuned.hidden, part)[...], getattr(model.hidden, part)[...])
    np.testing.assert_array_equal(tuned.norm.scale[...], model.norm.scale[...])
    assert float(np.abs(tuned.norm.bias[...] - model.norm.bias[...]).max()) > 0
    assert float(np.abs(tuned.out.kernel[...] - model.out.kernel[...]).max()) > 0


def test_what_cannot_be_done_is_named(trained, tmp_path):
    with pytest.raises(ValueError, match="init_from: expected the folder of a training run"):
        initialise_from(Tiny(nnx.Rngs(0)), tmp_path)
    with pytest.raises(ValueError, match="init_from: no parameter of the run"):
        initialise_from(nnx.Linear(2, 2, rngs=nnx.Rngs(0)), trained[0])
    with pytest.raises(ValueError, match=r"frozen: expected parts of the network \(hidden, norm, out"):
        fit(Tiny(nnx.Rngs(0)), split(), None, settings(frozen=("hid",)), progress=False)


def test_a_run_with_frozen_parts_goes_on(tmp_path):
    config = settings(epochs=2, frozen=("hidden",))
    first = fit(Tiny(nnx.Rngs(0)), split(), None, config, folder=tmp_path, progress=False)
    again = fit(Tiny(nnx.Rngs(1)), split(), None, config, folder=tmp_path, progress=False)
    np.testing.assert_array_equal(first.model.out.kernel[...], again.model.out.kernel[...])
