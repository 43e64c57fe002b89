"""A small network and data for the tests of the training loop, importable by the processes they start."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from cablejax.train import TrainConfig


class Split(NamedTuple):
    xyz: np.ndarray
    mask: np.ndarray
    label: np.ndarray


def split(clouds=24, seed=0):
    """Clouds whose class is their size."""
    rng = np.random.default_rng(seed)
    label = (np.arange(clouds) % 3).astype(np.int32)
    xyz = rng.normal(size=(clouds, 8, 3)) * (1.0 + label[:, None, None])
    return Split(xyz.astype(np.float32), np.ones((clouds, 8), bool), label)


class Tiny(nnx.Module):
    """A network of the library's call signature, with everything a state can hold."""

    def __init__(self, rngs, dropout=0.1):
        self.hidden = nnx.Linear(3, 16, rngs=rngs)
        self.norm = nnx.BatchNorm(16, momentum=0.9, use_fast_variance=False, rngs=rngs)
        self.dropout = nnx.Dropout(dropout, rngs=rngs)
        self.out = nnx.Linear(16, 3, rngs=rngs)

    def __call__(self, xyz, mask):
        pooled = jnp.sqrt(jnp.mean(xyz**2, axis=1, where=mask[..., None]))
        return self.out(self.dropout(jax.nn.relu(self.norm(self.hidden(pooled)))))


def settings(**changes):
    return TrainConfig(**{"optimizer": "adam", "learning_rate": 0.02, "epochs": 6, "batch_size": 8, **changes})


def weights(result):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(nnx.state(result.model, nnx.Param))]
