"""How an epoch is cut into batches, and which clouds each of them holds."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Int, PRNGKeyArray

from cablejax.train.config import TrainConfig
from cablejax.train.optimizers import OPTIMIZERS


class Plan(NamedTuple):
    """How an epoch is cut.

    Attributes:
        batches: Batches of an epoch.
        batch_size: Clouds of a batch.
        per_call: Batches of one compiled call; divides `batches`.
    """

    batches: int
    batch_size: int
    per_call: int


def make_plan(clouds: int, config: TrainConfig, model: nnx.Module | None = None) -> Plan:
    """Cut an epoch of `clouds` clouds, for a model if one is given.

    On the CPU a model of image convolutions takes one step a call: inside a loop XLA computes their gradients about a
    hundred times slower (jax 0.10.1: two 3x3 convolutions of 64 channels, 24 images of 64 x 64, 0.4 s outside and 30 s a
    step inside).

    Raises:
        ValueError: If there is no cloud.
    """
    if clouds < 1:
        raise ValueError("train: expected at least one cloud, got none")
    batch_size = min(config.batch_size, clouds)
    batches = clouds // batch_size
    slow = model is not None and jax.default_backend() == "cpu" and _convolves(model)
    most = 1 if slow else min(config.steps_per_dispatch, batches)
    per_call = next(size for size in range(most, 0, -1) if batches % size == 0)
    return Plan(batches, batch_size, batches if OPTIMIZERS[config.optimizer].full_set else per_call)


def _convolves(model: nnx.Module) -> bool:
    """Whether a model holds an image convolution."""
    return any(isinstance(part, nnx.Conv) for _, part in nnx.iter_graph(model))


def epoch_rows(
    config: TrainConfig, epoch: int, label: Int[np.ndarray, "clouds ..."], plan: Plan
) -> Int[Array, "calls s b"]:
    """The clouds of every batch of an epoch, drawn without replacement; the same for the same seed and epoch.

    With `config.balanced` each class is shuffled by itself and dealt out evenly over the epoch, so that batches hold the
    same mix of classes to within one cloud or two.

    Args:
        config: Its `seed` and `balanced` count.
        epoch: Counted from 0.
        label: Classes of the clouds `[clouds]`, or of their points `[clouds, n]`.
        plan: From `make_plan`.

    Raises:
        ValueError: If balanced batches are asked for where the points are labelled.
    """
    if config.balanced and np.ndim(label) > 1:
        raise ValueError(
            "balanced: expected False where the points are labelled, for a cloud then has no class, got True"
        )
    key = jax.random.fold_in(jax.random.key(config.seed), epoch)
    order = _dealt(label, key) if config.balanced else jax.random.permutation(key, len(label))
    return order[: plan.batches * plan.batch_size].reshape(-1, plan.per_call, plan.batch_size)


def _dealt(label: np.ndarray, key: PRNGKeyArray) -> Array:
    """An order `[clouds]` in which every class comes up evenly: cloud j of a class's n at a random place in [j/n, (j+1)/n)."""
    within, place = np.asarray(jax.random.uniform(key, (2, len(label))))
    grouped = np.lexsort((within, label))
    count = np.bincount(label)
    rank = np.empty(len(label), int)
    rank[grouped] = np.arange(len(label)) - np.repeat(np.cumsum(count) - count, count)
    return jnp.asarray(np.argsort((rank + place) / count[label], kind="stable"))
