"""Start a network from another run's weights, with part of it held fixed if wanted."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array

from cablejax.io.checkpoints import CorruptCheckpoint, checkpoint_files, read_checkpoint

# Where a checkpoint of `fit` keeps parameters and statistics: the best epoch's, else the averaged, else the last ones.
PARAMETERS = ("[1][0]", "[0].ema", "[0].params")
STATISTICS = ("[1][1]", "[0].rest")


class Transferred(NamedTuple):
    """A network with another's weights.

    Attributes:
        model: Of its own.
        kept: Names of the parameters and statistics that stayed as they were: absent from the other network, or of
            another shape there, such as the logits of other classes.
    """

    model: nnx.Module
    kept: list[str]


def initialise_from(model: nnx.Module, folder: str | os.PathLike[str]) -> Transferred:
    """A copy of a model with the weights and running statistics that a run of `fit` left, where name and shape agree.

    Args:
        model: The network to start; not changed.
        folder: The folder that `fit` was given.

    Raises:
        ValueError: If there is no whole checkpoint, or nothing in it fits.
    """
    graphdef, params, rest = nnx.split(model, nnx.Param, ...)
    arrays = _newest_arrays(Path(folder) / "checkpoints")
    kept: list[str] = []
    params = _filled(params, arrays, PARAMETERS, kept)
    if len(kept) == len(jax.tree.leaves(params)):
        raise ValueError(f"init_from: no parameter of the run in {folder} fits this network")
    return Transferred(nnx.merge(graphdef, params, _filled(rest, arrays, STATISTICS, kept), copy=True), kept)


def frozen_updates(updates: Any, frozen: Sequence[str]) -> Any:
    """Updates with zeros for the parameters whose dotted name starts with one of `frozen`.

    Raises:
        ValueError: If a name fits no parameter.
    """
    if not frozen:
        return updates
    names = [dotted(path) for path, _ in jax.tree.leaves_with_path(updates)]
    for part in frozen:
        if not any(_within(name, part) for name in names):
            parts = sorted({name.split(".")[0] for name in names})
            raise ValueError(
                f"frozen: expected parts of the network ({', '.join(parts)}, or longer names), got {part!r}"
            )

    def hold(path: Any, update: Array) -> Array:
        return jnp.zeros_like(update) if any(_within(dotted(path), part) for part in frozen) else update

    return jax.tree.map_with_path(hold, updates)


def dotted(path: Any) -> str:
    """A leaf's path as `layers.0.kernel`."""
    keys = (str(getattr(key, "key", getattr(key, "name", key))) for key in path)
    return ".".join(keys).removesuffix(".value")


def _within(name: str, part: str) -> bool:
    return name == part or name.startswith(part + ".")


def _newest_arrays(folder: Path) -> dict[str, np.ndarray]:
    """The plain arrays of the newest whole checkpoint by their paths."""
    for path in reversed(checkpoint_files(folder)):
        try:
            header, data = read_checkpoint(path)
        except CorruptCheckpoint:
            continue
        found, offset = {}, 0
        for entry in header["leaves"]:
            content = data[offset : offset + entry["bytes"]]
            offset += entry["bytes"]
            if entry["kind"] == "array":
                found[entry["path"]] = np.frombuffer(content, jnp.dtype(entry["dtype"])).reshape(entry["shape"])
        return found
    raise ValueError(f"init_from: expected the folder of a training run, found no whole checkpoint in {folder}")


def _filled(tree: Any, arrays: dict[str, np.ndarray], places: Sequence[str], kept: list[str]) -> Any:
    """The tree with stored arrays in place of those of the same name and shape; names of the others go to `kept`."""

    def fill(path: Any, leaf: Array) -> Array:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) or not jnp.issubdtype(leaf.dtype, jnp.floating):
            return leaf
        for place in places:
            stored = arrays.get(place + jax.tree_util.keystr(path))
            if stored is not None and stored.shape == leaf.shape:
                return jnp.asarray(stored, leaf.dtype)
        kept.append(dotted(path))
        return leaf

    return jax.tree.map_with_path(fill, tree)
