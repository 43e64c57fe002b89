"""What TensorBoard shows of a run beside its curves: channel attention after every epoch, and a few clouds."""

from functools import partial
from typing import Any

import jax
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.io.tensorboard import RunLogger
from cablejax.train.metrics import Clouds

SHOWN = 8  # clouds that are drawn, and over which attention is gathered
COLOR = ((31, 119, 180), (255, 127, 14), (44, 160, 44), (214, 39, 40), (148, 103, 189), (140, 86, 75))


@partial(jax.jit, static_argnums=0)
def _attention(graphdef: Any, state: Any, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> list[Array]:
    return nnx.merge(graphdef, state, copy=True).attention_weights(xyz, mask)


def log_attention(log: RunLogger, graphdef: Any, state: Any, split: Clouds, epoch: int) -> None:
    """A histogram of each layer's channel weights over the first clouds of a split; nothing for networks without.

    Args:
        log: Where it goes.
        graphdef: The network in evaluation mode, with `state` split by `nnx.split`.
        state: Its weights.
        split: Clouds.
        epoch: Step of the log.
    """
    if not hasattr(nnx.merge(graphdef, state), "attention_weights"):
        return
    for layer, weights in enumerate(_attention(graphdef, state, split.xyz[:SHOWN], split.mask[:SHOWN]), start=1):
        log.histogram(f"attention/layer{layer}", np.asarray(weights), epoch)


def log_clouds(log: RunLogger, name: str, split: Clouds, step: int) -> None:
    """The first clouds of a split as one mesh of a batch, coloured by class, or point by point; padding lies in the centre."""
    mask = np.asarray(split.mask[:SHOWN])
    xyz = np.where(mask[..., None], np.asarray(split.xyz[:SHOWN]), 0.0)
    colors = np.asarray(COLOR)[np.asarray(split.label[:SHOWN]) % len(COLOR)]
    colors = colors if colors.ndim == 3 else colors[:, None, :]
    log.mesh(name, xyz, step, color=np.broadcast_to(colors, xyz.shape))
