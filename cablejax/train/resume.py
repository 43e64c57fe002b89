"""A run's folder: what is needed to go on after a kill as if nothing had happened."""

import csv
import dataclasses
import hashlib
import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.io.atomic import atomic_write
from cablejax.io.checkpoints import restore_checkpoint, save_checkpoint
from cablejax.train.config import TrainConfig
from cablejax.train.metrics import Clouds, arrays_of

CURVES = "curves.csv"


def data_checksum(*splits: Clouds | None, also: str | None = None) -> str:
    """SHA-256 over the arrays of the splits that a network learns from, shapes included; see `also_learnt`."""
    digest = hashlib.sha256()
    for split in splits:
        for array in () if split is None else arrays_of(split, also=also):
            host = np.ascontiguousarray(array)
            digest.update(f"{host.dtype.str}{host.shape}".encode())
            digest.update(host.data)
    return digest.hexdigest()


def write_curves(path: Path, history: list[dict[str, Any]]) -> None:
    """A history as CSV: a row an epoch, a column for each of its numbers, empty where there is none."""
    names = [name for name, value in history[0].items() if not isinstance(value, list)]
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, names, extrasaction="ignore")
    table.writeheader()
    table.writerows(history)
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


class RunFolder:
    """Checkpoints of one run, refused to a run with other settings or other data.

    Args:
        folder: Made if it is missing.
        config: The run's settings.
        checksum: Of the run's data, see `data_checksum`.
    """

    def __init__(self, folder: str | os.PathLike[str], config: TrainConfig, checksum: str):
        self.folder = Path(folder).absolute()
        self.identity: dict[str, Any] = {
            # As JSON will give it back: tuples are lists there.
            "config": json.loads(json.dumps(dataclasses.asdict(config))),
            "data": checksum,
        }

    def load(self, like: Any) -> tuple[Any, list[dict[str, Any]]] | None:
        """The newest whole checkpoint as `(tree, history)`, None in a fresh folder.

        Raises:
            ValueError: If the folder holds a run with other settings, data or shapes; it says which.
        """
        found = restore_checkpoint(self.folder / "checkpoints", like)
        if found is None:
            return None
        self._compare(found.meta)
        return found.tree, found.meta["history"]

    def save(self, epoch: int, tree: Any, history: list[dict[str, Any]]) -> None:
        """Write the state after `epoch` epochs, atomically, and the history so far as `curves.csv`."""
        save_checkpoint(self.folder / "checkpoints", epoch, tree, meta={**self.identity, "history": history}, keep=2)
        write_curves(self.folder / CURVES, history)

    def save_diverged(self, step: int, tree: Any, meta: dict[str, Any]) -> Path:
        """Write a state that holds NaN, to be looked at, beside the good ones."""
        return save_checkpoint(self.folder / "diverged", step, tree, meta={**self.identity, **meta}, keep=1)

    def _compare(self, meta: dict[str, Any]) -> None:
        stored, now = meta["config"], self.identity["config"]
        for name in sorted({*stored, *now}):
            if stored.get(name) != now.get(name):
                raise ValueError(
                    f"folder: {self.folder} holds a run with {name} = {stored.get(name)!r}, this one has "
                    f"{now.get(name)!r}; take another folder, or remove it to start over"
                )
        if meta["data"] != self.identity["data"]:
            raise ValueError(f"folder: {self.folder} holds a run on other data; take another folder")
