"""Datasets on disk: splits written once with a checksum, and arrays of other makers (ModelNet10) as splits.

A stored split is an uncompressed NumPy `.npz` with the arrays of `Split`: `xyz` float32 `[clouds, n, 3]` in mm,
`mask` bool `[clouds, n]`, `label` int32 `[clouds]`, `diameter_mm` float32 `[clouds]`, and where it is known `on_cable` bool
`[clouds, n]`; a string `config` (the
`DatasetConfig` and the split's name as JSON); and a string `sha256`, the digest of the arrays' bytes in that order
followed by `config` in UTF-8. NumPy alone reads it.
"""

import hashlib
import io
import json
import os
import zipfile
import zlib
from dataclasses import asdict
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from cablejax.simulate.dataset import DatasetConfig, Split

FIELDS = {"xyz": np.float32, "mask": np.bool_, "label": np.int32, "diameter_mm": np.float32}
OPTIONAL = {"on_cable": np.bool_}
# What NumPy and zipfile raise on damaged archives; 3,000 mutated files raised nothing else.
UNREADABLE = (KeyError, ValueError, EOFError, OSError, RuntimeError, zipfile.BadZipFile, zlib.error)


def _digest(arrays: dict[str, np.ndarray], config: str) -> str:
    digest = hashlib.sha256()
    for name in (*FIELDS, *(name for name in OPTIONAL if name in arrays)):
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    digest.update(config.encode())
    return digest.hexdigest()


def save_split(path: str | Path, split: Split, *, config: DatasetConfig, name: str) -> str:
    """Write a split; a killed write leaves what was there before.

    Args:
        path: A file name that ends in .npz.
        split: What `make_split` gave.
        config: What it was made from.
        name: "train", "validation" or "test".

    Returns:
        The checksum.

    Raises:
        ValueError: If the file name does not end in .npz.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path: expected a name that ends in .npz, got {str(path)!r}")
    known = FIELDS | {field: kind for field, kind in OPTIONAL.items() if getattr(split, field) is not None}
    arrays = {field: np.asarray(getattr(split, field), kind) for field, kind in known.items()}
    text = json.dumps({"config": asdict(config), "split": name}, sort_keys=True)
    checksum = _digest(arrays, text)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays, config=np.array(text), sha256=np.array(checksum))
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return checksum


def load_split(path: str | Path) -> tuple[Split, DatasetConfig, str]:
    """Read a stored split: the clouds, what they were made from, and the split's name.

    Raises:
        ValueError: If the file is no stored split or does not match its checksum.
        OSError: If it cannot be read.
    """
    data = Path(path).read_bytes()
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {field: file[field] for field in (*FIELDS, *OPTIONAL) if field in FIELDS or field in file.files}
            text, checksum = str(file["config"]), str(file["sha256"])
    except UNREADABLE as error:
        raise ValueError(f"{path}: expected a stored split, got {error}") from None
    if _digest(arrays, text) != checksum:
        raise ValueError(f"{path}: the checksum does not match: the file is damaged")
    about = json.loads(text)
    about["config"]["sizes_mm2"] = tuple(about["config"]["sizes_mm2"])
    split = Split(**{name: jnp.asarray(array) for name, array in arrays.items()})
    return split, DatasetConfig(**about["config"]), about["split"]


def load_arrays(
    path: str | Path, *, n_points: int = 1024, validation_share: float = 0.15, seed: int = 0
) -> tuple[Split, Split, tuple[str, ...]]:
    """Clouds of another maker, as ModelNet10's: a `.npz` of `xyz` `[clouds, n, 3]`, `label` `[clouds]`, `classes` `[k]`.

    The file holds one official split; it is divided into training and validation here, each class by the same share, by
    a seeded draw. Clouds are centred, never scaled. They have no diameter: `diameter_mm` is NaN, and their unit is the
    file's.

    Args:
        path: `$CABLEJAX_DATA/classification/modelnet10_train_1024.npz`, or any of that form.
        n_points: Points kept a cloud, drawn without replacement where the file has more.
        validation_share: Share of each class for validation.
        seed: Root of both draws.

    Returns:
        Training clouds, validation clouds, class names in the order of the labels.

    Raises:
        ValueError: If the arrays are not there or do not fit together, or an argument is out of range.
        OSError: If the file cannot be read.
    """
    if not 0 < validation_share < 1:
        raise ValueError(f"validation_share: expected between 0 and 1, got {validation_share!r}")
    points, labels, names = _read_arrays(path)
    if not 1 <= n_points <= points.shape[1]:
        raise ValueError(f"n_points: expected 1 to the file's {points.shape[1]}, got {n_points!r}")
    rng = np.random.default_rng(seed)
    points = points[:, np.sort(rng.permutation(points.shape[1])[:n_points])]
    order = rng.permutation(len(labels))
    held = np.zeros(len(labels), bool)
    for number in range(len(names)):
        of_class = order[labels[order] == number]
        held[of_class[: round(validation_share * len(of_class))]] = True
    return _as_split(points[~held], labels[~held]), _as_split(points[held], labels[held]), names


def _read_arrays(path: str | Path) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Points `[clouds, n, 3]`, labels `[clouds]` and class names, checked against each other."""
    data = Path(path).read_bytes()
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            points, labels, classes = file["xyz"], file["label"], file["classes"]
    except UNREADABLE as error:
        raise ValueError(f"{path}: expected the arrays xyz, label and classes, got {error}") from None
    if points.ndim != 3 or points.shape[2] != 3 or labels.shape != points.shape[:1] or classes.ndim != 1:
        shapes = f"{list(points.shape)}, {list(labels.shape)}, {list(classes.shape)}"
        raise ValueError(f"{path}: expected xyz [clouds, n, 3], label [clouds], classes [k], got {shapes}")
    if not np.isfinite(points).all():
        raise ValueError(f"{path}: expected finite coordinates, got NaN or infinite ones")
    if labels.size and not (labels.min() >= 0 and labels.max() < len(classes)):
        raise ValueError(f"{path}: expected labels 0 to {len(classes) - 1}, got {labels.min()} to {labels.max()}")
    return points, labels.astype(np.int64), tuple(str(name) for name in classes)


def _as_split(points: Float[np.ndarray, "clouds n 3"], labels: np.ndarray) -> Split:
    centred = points - points.mean(axis=1, keepdims=True)
    return Split(
        jnp.asarray(centred, jnp.float32),
        jnp.ones(points.shape[:2], bool),
        jnp.asarray(labels, jnp.int32),
        jnp.full(len(labels), jnp.nan, jnp.float32),
    )
