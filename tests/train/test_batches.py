"""How an epoch is cut."""

import jax
import numpy as np
import pytest
from flax import nnx

from cablejax.train import TrainConfig
from cablejax.train.batches import epoch_rows, make_plan

LABEL = np.random.default_rng(0).permutation(np.repeat(np.arange(5), [24, 24, 24, 24, 4]))


def rows(epoch: int = 0, **options) -> np.ndarray:
    config = TrainConfig(batch_size=10, **options)
    return np.asarray(epoch_rows(config, epoch, LABEL, make_plan(len(LABEL), config)))


@pytest.mark.parametrize("balanced", [False, True])
def test_an_epoch_takes_each_cloud_once_in_an_order_of_its_own(balanced):
    first = rows(balanced=balanced)
    assert sorted(first.reshape(-1)) == list(range(100))
    np.testing.assert_array_equal(first, rows(balanced=balanced))
    assert not np.array_equal(first, rows(epoch=1, balanced=balanced))
    assert not np.array_equal(first, rows(seed=1, balanced=balanced))


def test_balanced_batches_hold_the_same_mix():
    counts = np.stack([np.bincount(LABEL[batch], minlength=5) for batch in rows(balanced=True).reshape(-1, 10)])
    share = np.bincount(LABEL) / 10  # of a batch: 2.4 of the large classes, .4 of the small one
    assert np.abs(counts - share).max() < 2  # a stretch of s expected clouds holds between s - 2 and s + 2
    shuffled = np.stack([np.bincount(LABEL[batch], minlength=5) for batch in rows().reshape(-1, 10)])
    assert counts.std(axis=0).mean() < 0.6 * shuffled.std(axis=0).mean()


class Image(nnx.Module):
    def __init__(self):
        self.conv = nnx.Conv(1, 1, (3, 3), rngs=nnx.Rngs(0))


def test_image_convolutions_take_one_step_a_call_on_the_cpu():
    config = TrainConfig(batch_size=10)
    assert make_plan(100, config).per_call == 10
    assert make_plan(100, config, Image()).per_call == (1 if jax.default_backend() == "cpu" else 10)
