"""Training where each point has a label of its own: the same loop, losses and accuracies over the valid points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.io import RunLogger
from cablejax.train import evaluate, fit, intersection_over_union
from cablejax.train.losses import cloud_mean
from tests.train.tiny import Split, settings, weights


def labelled(clouds=24, n=16, seed=0) -> Split:
    """Points whose class is the octant's third coordinate, below or above; the last four are padding with a wrong label."""
    xyz = np.random.default_rng(seed).normal(size=(clouds, n, 3)).astype(np.float32)
    mask = np.broadcast_to(np.arange(n) < n - 4, (clouds, n))
    label = (xyz[..., 2] > 0).astype(np.int32)
    return Split(xyz, mask, np.where(mask, label, 1 - label))


class Pointwise(nnx.Module):
    """A linear label of each point."""

    def __init__(self, rngs):
        self.out = nnx.Linear(3, 2, rngs=rngs)

    def __call__(self, xyz, mask):
        return self.out(xyz)


def test_points_are_learnt_and_padding_is_not(tmp_path):
    train, validation = labelled(), labelled(seed=1)
    with RunLogger(tmp_path / "log") as log:
        result = fit(Pointwise(nnx.Rngs(0)), train, validation, settings(epochs=40), logger=log, progress=False)
    last = result.history[-1]
    assert last.validation_overall > 0.95
    assert 0.95 < last.train_overall <= 1.0
    found = evaluate(result.model, validation)
    assert found.confusion.sum() == validation.mask.sum()
    assert found.overall > 0.95


def test_the_loss_is_the_mean_over_clouds_of_their_valid_points():
    data = labelled(8)
    model = Pointwise(nnx.Rngs(0))
    logits = np.asarray(model(data.xyz, data.mask), np.float64)
    nats = np.log(np.exp(logits).sum(axis=-1)) - np.take_along_axis(logits, data.label[..., None], -1)[..., 0]
    expected = np.mean([row[valid].mean() for row, valid in zip(nats, data.mask, strict=True)])
    result = fit(model, data, None, settings(epochs=1, batch_size=8), progress=False)
    assert result.history[0].train_loss == pytest.approx(expected, rel=1e-5)


def test_a_killed_run_goes_on_with_the_same_bits(tmp_path):
    whole = fit(Pointwise(nnx.Rngs(0)), labelled(), labelled(seed=1), settings(epochs=4), progress=False)

    class StopError(Exception):
        pass

    def epochs(epoch):
        if epoch == 2 and not (tmp_path / "stopped").exists():
            (tmp_path / "stopped").touch()
            raise StopError
        return labelled()

    with pytest.raises(StopError):
        fit(
            Pointwise(nnx.Rngs(0)),
            epochs,
            labelled(seed=1),
            settings(epochs=4),
            folder=tmp_path / "run",
            progress=False,
        )
    again = fit(
        Pointwise(nnx.Rngs(0)), epochs, labelled(seed=1), settings(epochs=4), folder=tmp_path / "run", progress=False
    )
    for ours, theirs in zip(weights(again), weights(whole), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_balanced_batches_need_clouds_with_a_class():
    with pytest.raises(ValueError, match="balanced: expected False where the points are labelled"):
        fit(Pointwise(nnx.Rngs(0)), labelled(), None, settings(balanced=True), progress=False)


def test_cloud_means_leave_padding_out():
    values, mask = jnp.asarray([[1.0, 3.0, 9.0], [2.0, 9.0, 9.0], [9.0, 9.0, 9.0]]), np.eye(3, dtype=bool)
    mask[0, 1], mask[1] = True, [True, False, False]
    np.testing.assert_allclose(cloud_mean(values, jnp.asarray(mask)), [2.0, 2.0, 9.0])
    assert float(cloud_mean(values, jnp.zeros((3, 3), bool)).sum()) == 0
    assert cloud_mean(jnp.ones((1, 2), bool), jnp.ones((1, 2), bool)).dtype == jax.dtypes.canonicalize_dtype(float)


def test_intersection_over_union():
    found = intersection_over_union(np.array([[5, 1, 0], [2, 2, 0], [0, 0, 0]]))
    np.testing.assert_allclose(found, [5 / 8, 2 / 5, np.nan])
