"""Files in and out: scanner files, checkpoints, provenance and TensorBoard logs.

Scanner files do without jax; checkpoints and logs import it when they are first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

from cablejax.io.atomic import atomic_write
from cablejax.io.open3d_import import import_open3d
from cablejax.io.points import PointFile, iter_points, read_points
from cablejax.io.provenance import git_state, jsonable, provenance, read_json, write_json
from cablejax.io.raw import PointFileError
from cablejax.io.region import Region, is_copc, read_region
from cablejax.io.sources import ENDINGS as READABLE
from cablejax.io.write import PointWriter, write_points

if TYPE_CHECKING:
    from cablejax.io.checkpoints import (
        Checkpoint,
        CorruptCheckpoint,
        checkpoint_files,
        restore_checkpoint,
        save_checkpoint,
    )
    from cablejax.io.tensorboard import RunLogger

__all__ = [
    "READABLE",
    "Checkpoint",
    "CorruptCheckpoint",
    "PointFile",
    "PointFileError",
    "PointWriter",
    "Region",
    "RunLogger",
    "atomic_write",
    "checkpoint_files",
    "git_state",
    "import_open3d",
    "is_copc",
    "iter_points",
    "jsonable",
    "provenance",
    "read_json",
    "read_points",
    "read_region",
    "restore_checkpoint",
    "save_checkpoint",
    "write_json",
    "write_points",
]

_LATER = dict.fromkeys(
    ("Checkpoint", "CorruptCheckpoint", "checkpoint_files", "restore_checkpoint", "save_checkpoint"),
    "cablejax.io.checkpoints",
) | {"RunLogger": "cablejax.io.tensorboard"}


def __getattr__(name: str) -> Any:
    """Import what needs jax when it is first used (PEP 562)."""
    if name not in _LATER:
        raise AttributeError(f"module 'cablejax.io' has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)
