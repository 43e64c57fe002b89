"""Checkpoints of array pytrees: one checksummed file a step, restored bit for bit, without pickle.

A file holds, in this order: `MAGIC`, the header's length (8 bytes, little-endian), the header (JSON: step, meta, one
entry a leaf), the leaves' bytes, and the SHA-256 of everything before it. The tree's structure is not stored: it comes
from the tree that `restore_checkpoint` is given, and the leaves' paths, types and shapes must agree with it.
"""

import hashlib
import json
import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax

from cablejax.io.atomic import atomic_write, remove_parts
from cablejax.io.checkpoint_leaves import Leaf, decode_leaf, encode_leaf, same_kind

MAGIC = b"cablejax checkpoint 1\n"
DIGEST_BYTES = hashlib.sha256().digest_size
FILE_PATTERN = re.compile(r"step_(\d{10,})\.ckpt")


class Checkpoint(NamedTuple):
    """A restored checkpoint.

    Attributes:
        step: The step it was saved at.
        tree: The pytree, with the structure of `like`.
        meta: What was saved beside it, JSON-ready.
    """

    step: int
    tree: Any
    meta: dict[str, Any]


class CorruptCheckpoint(Exception):
    """A checkpoint file is truncated, altered, or no checkpoint."""


def save_checkpoint(
    folder: str | os.PathLike[str], step: int, tree: Any, *, meta: Mapping[str, Any] | None = None, keep: int = 3
) -> Path:
    """Write a checkpoint in one step, then remove all but the last few.

    Checkpoints of later steps are removed too: they belong to a run that was abandoned for this one.

    Args:
        folder: Made if it is missing. One writer at a time.
        step: Steps done so far.
        tree: Leaves may be JAX or NumPy arrays of any dtype (bfloat16 included), typed random keys, and Python
            numbers, strings or booleans.
        meta: JSON-ready values kept beside the tree, such as the configuration and the data's checksum.
        keep: How many checkpoints stay.

    Returns:
        The file written.

    Raises:
        ValueError: If `step` is negative, `keep` is below 1, or a leaf or `meta` cannot be stored.
        OSError: If the disk is full or the folder cannot be written; the earlier checkpoints are untouched.
    """
    if step < 0:
        raise ValueError(f"step: expected 0 or more, got {step}")
    if keep < 1:
        raise ValueError(f"keep: expected 1 or more, got {keep}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    remove_parts(folder, "step_*.ckpt")
    path = folder / f"step_{step:010d}.ckpt"
    leaves = [encode_leaf(jax.tree_util.keystr(name), value) for name, value in _flatten(tree)]
    entries = [leaf.entry for leaf in leaves]
    try:
        header = json.dumps({"step": step, "meta": dict(meta or {}), "leaves": entries}).encode()
    except TypeError as error:
        raise ValueError(f"meta: expected JSON-ready values, got {error}") from error
    _write(path, header, leaves)
    _prune(folder, step, keep)
    return path


def restore_checkpoint(folder: str | os.PathLike[str], like: Any) -> Checkpoint | None:
    """Read the newest checkpoint that is whole.

    Args:
        folder: Where `save_checkpoint` wrote.
        like: A tree of the same structure, for instance the freshly initialised state. Its leaves give the kind of
            each restored leaf (JAX array with its sharding, NumPy array, number) and must agree in type and shape.

    Returns:
        Step, tree and meta (unpacks as a tuple), or None where there is no whole checkpoint. A damaged file is
        reported as a warning, and the one before it is taken.

    Raises:
        ValueError: If a whole checkpoint does not fit `like`, naming the first leaf that differs.
    """
    for path in reversed(checkpoint_files(folder)):
        try:
            header, data = read_checkpoint(path)
        except CorruptCheckpoint as error:
            warnings.warn(f"{path.name}: {error}; falling back to the checkpoint before it", stacklevel=2)
            continue
        return Checkpoint(header["step"], _rebuild(path, header["leaves"], data, like), header["meta"])
    return None


def checkpoint_files(folder: str | os.PathLike[str]) -> list[Path]:
    """The checkpoint files of a folder, oldest step first; an absent folder has none."""
    folder = Path(folder)
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if FILE_PATTERN.fullmatch(path.name)), key=_step_of)


def read_checkpoint(path: str | os.PathLike[str]) -> tuple[dict[str, Any], memoryview]:
    """Read and verify one file.

    Returns:
        The header (keys `step`, `meta`, `leaves`) and the leaves' bytes.

    Raises:
        CorruptCheckpoint: If the file cannot be read, is truncated, or its checksum does not hold.
    """
    try:
        content = memoryview(Path(path).read_bytes())
    except OSError as error:
        raise CorruptCheckpoint(f"cannot be read ({error.strerror})") from error
    start = len(MAGIC) + 8
    if len(content) < start + DIGEST_BYTES or bytes(content[: len(MAGIC)]) != MAGIC:
        raise CorruptCheckpoint("is truncated or no checkpoint of this version")
    if hashlib.sha256(content[:-DIGEST_BYTES]).digest() != bytes(content[-DIGEST_BYTES:]):
        raise CorruptCheckpoint("is damaged (its SHA-256 does not hold)")
    end = start + int.from_bytes(content[len(MAGIC) : start], "little")
    return json.loads(bytes(content[start:end])), content[end:-DIGEST_BYTES]


def _flatten(tree: Any) -> list[tuple[Any, Any]]:
    """Leaves with their paths; keys of a flattened tree are unique."""
    return jax.tree_util.tree_flatten_with_path(tree)[0]


def _write(path: Path, header: bytes, leaves: list[Leaf]) -> None:
    """Stream the file through the checksum."""
    digest = hashlib.sha256()
    with atomic_write(path) as file:
        for chunk in (MAGIC, len(header).to_bytes(8, "little"), header, *(leaf.data for leaf in leaves)):
            digest.update(chunk)
            file.write(chunk)
        file.write(digest.digest())


def _step_of(path: Path) -> int:
    match = FILE_PATTERN.fullmatch(path.name)
    return int(match[1]) if match else -1


def _prune(folder: Path, step: int, keep: int) -> None:
    """Remove checkpoints of later steps, and all but the `keep` newest of the rest."""
    files = checkpoint_files(folder)
    past = [path for path in files if _step_of(path) <= step]
    for path in {*files} - {*past[-keep:]}:
        path.unlink(missing_ok=True)


def _rebuild(path: Path, entries: list[dict[str, Any]], data: memoryview, like: Any) -> Any:
    """The tree of `like` with the stored leaves."""
    wanted = [(jax.tree_util.keystr(name), leaf) for name, leaf in _flatten(like)]
    stored = {entry["path"] for entry in entries}
    missing = [name for name, _ in wanted if name not in stored]
    extra = sorted(stored - {name for name, _ in wanted})
    if missing or extra:
        raise ValueError(f"like: {path.name} lacks the leaves {missing[:3]} and has besides {extra[:3]}")
    leaves, offset = {}, 0
    for entry in entries:
        leaves[entry["path"]] = (entry, data[offset : offset + entry["bytes"]])
        offset += entry["bytes"]
    values = []
    for name, template in wanted:
        entry, content = leaves[name]
        if reason := same_kind(entry, template):
            raise ValueError(f"like: leaf {name} of {path.name} {reason}")
        values.append(decode_leaf(entry, content, template))
    return jax.tree_util.tree_unflatten(jax.tree_util.tree_structure(like), values)
