"""Files in and out: checkpoints, provenance and TensorBoard logs."""

from cablejax.io.atomic import atomic_write
from cablejax.io.checkpoints import Checkpoint, CorruptCheckpoint, checkpoint_files, restore_checkpoint, save_checkpoint
from cablejax.io.provenance import git_state, jsonable, provenance, read_json, write_json
from cablejax.io.tensorboard import RunLogger

__all__ = [
    "Checkpoint",
    "CorruptCheckpoint",
    "RunLogger",
    "atomic_write",
    "checkpoint_files",
    "git_state",
    "jsonable",
    "provenance",
    "read_json",
    "restore_checkpoint",
    "save_checkpoint",
    "write_json",
]
