"""The network that fits a cylinder to the points it takes for the cable's: what it gives, its laws, its training."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.nets import ADGCNNFit, build_model
from cablejax.simulate import DatasetConfig, Split, make_split
from cablejax.train import TrainConfig, evaluate, fit

SIZES = DatasetConfig(sizes_mm2=(25, 150, 630), n_points=96, clouds_per_class=8, version="real-like")
SMALL = {"k": 8, "widths": (8, 8), "shared_width": 16, "point_head": (8,), "head": (8,), "iterations": 6}


@pytest.fixture(scope="module")
def clouds() -> Split:
    return make_split(SIZES, "train")


def network() -> nnx.Module:
    return build_model("adgcnn_fit", 3, rngs=nnx.Rngs(0), diameters_mm=SIZES.diameters_mm, **SMALL)


@partial(jax.jit, static_argnums=0)
def _said(graphdef, state, xyz, mask):
    return nnx.merge(graphdef, state, copy=True).estimate(xyz, mask)


def said(model, xyz, mask):
    model.eval()
    return _said(*nnx.split(model), xyz[:8], mask[:8])


def test_shapes_and_laws(clouds):
    model = network()
    found = said(model, clouds.xyz, clouds.mask)
    assert found.logits.shape == (8, 3)
    assert found.scores.shape == (8, 96)
    assert (np.asarray(found.std_mm) > 0).all()
    order = np.random.default_rng(1).permutation(96)
    shuffled = said(model, clouds.xyz[:, order], clouds.mask[:, order])
    np.testing.assert_allclose(shuffled.scores, found.scores[:, order], atol=5e-3)
    np.testing.assert_allclose(shuffled.diameter_mm, found.diameter_mm, rtol=2e-2)
    holed = clouds.mask.at[:, -20:].set(False)
    first, other = (said(model, jnp.where(holed[..., None], clouds.xyz, filler), holed) for filler in (0.0, 1e3))
    for a, b in zip(first, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3)


def test_before_training_the_logits_are_those_of_the_fit_alone(clouds):
    """The head starts at 0: the likeliest size is the one nearest to the fitted diameter."""
    found = said(network(), clouds.xyz, clouds.mask)
    nearest = np.abs(np.asarray(found.diameter_mm)[:, None] - np.asarray(SIZES.diameters_mm)).argmin(axis=1)
    np.testing.assert_array_equal(np.argmax(found.logits, axis=1), nearest)


def test_points_and_sizes_are_learnt_together(clouds):
    config = TrainConfig(optimizer="adam", learning_rate=0.01, epochs=12, batch_size=8, clip_norm=1.0, balanced=True)
    result = fit(network(), clouds, clouds, config, progress=False)
    found = evaluate(result.model, clouds)
    scores = np.asarray(said(result.model, clouds.xyz, clouds.mask).scores)
    mask, truth = np.asarray(clouds.mask)[:8], np.asarray(clouds.on_cable)[:8]
    assert ((scores > 0) == truth)[mask].mean() > max(truth[mask].mean(), 0.85)
    assert result.history[-1].train_loss < 0.6 * result.history[0].train_loss
    assert found.overall > 0.6  # a third by guessing
    assert found.diameter is not None


def test_clouds_that_do_not_know_their_points_are_refused(clouds):
    with pytest.raises(ValueError, match="split: expected clouds with on_cable"):
        fit(network(), clouds._replace(on_cable=None), None, TrainConfig(optimizer="adam", epochs=1), progress=False)


def test_a_diameter_for_each_class_is_asked_for():
    with pytest.raises(ValueError, match="diameters_mm: expected one of each of 3 classes, got 2"):
        ADGCNNFit(3, diameters_mm=(20.0, 30.0), rngs=nnx.Rngs(0))


def test_large_clouds_are_scored_at_the_density_learnt(clouds):
    """Every second row makes a cloud of its own, each scored as it would be alone."""
    dealt = build_model(
        "adgcnn_fit", 3, rngs=nnx.Rngs(0), diameters_mm=SIZES.diameters_mm, **SMALL, most_points=48
    )  # as many weights, and the same
    whole = said(dealt, clouds.xyz, clouds.mask)
    for first in (0, 1):
        alone = said(dealt, clouds.xyz[:, first::2], clouds.mask[:, first::2])
        np.testing.assert_allclose(whole.scores[:, first::2], alone.scores, atol=1e-3)
    assert whole.logits.shape == (8, 3)
