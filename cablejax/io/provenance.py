"""Where a number came from: revision, versions, device, threads and seeds, and nothing that names a machine."""

import dataclasses
import datetime
import importlib.metadata
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from cablejax.io.atomic import atomic_write

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("cablejax", "jax", "jaxlib", "flax", "optax", "numpy", "scipy", "open3d")
THREAD_VARIABLES = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "XLA_FLAGS")


def provenance(*, seeds: int | Sequence[int] | Mapping[str, int], config: Any = None) -> dict[str, Any]:
    """Describe the program, the machine's kind and the seeds behind a result.

    Holds no path, user or host name. Absolute paths in `config` are cut to their last part.

    Args:
        seeds: The seeds of the run: one, several, or by name.
        config: The configuration: a dataclass or nested mappings, sequences and scalars.

    Returns:
        A JSON-ready dict with the keys `git`, `versions`, `python`, `platform`, `cpu`, `device`, `seeds`, `config` and
        `date`. `git.revision` is None outside a checkout; `git.dirty` is True where tracked files, or untracked ones
        that are not ignored, differ from the revision.

    Example:
        >>> provenance(seeds=[0, 1])["seeds"]
        [0, 1]
    """
    import jax

    device = jax.devices()[0]
    return {
        "git": git_state(),
        "versions": {name: _version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": {"system": platform.system(), "release": platform.release(), "machine": platform.machine()},
        "cpu": {"model": _cpu_model(), "count": os.cpu_count(), "usable": _usable_cpus(), "threads": _threads()},
        "device": {"platform": device.platform, "kind": device.device_kind, "count": jax.device_count()},
        "seeds": jsonable(seeds),
        "config": _without_paths(jsonable(config)),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def git_state(folder: Path = REPOSITORY) -> dict[str, Any]:
    """Revision and dirty flag of the checkout whose root is `folder`; None where it is no checkout's root.

    Files under `results/` do not count: a command that writes two of them would call the second one dirty.
    """
    top = _git(folder, "rev-parse", "--show-toplevel")
    revision = _git(folder, "rev-parse", "HEAD")
    if top is None or revision is None or Path(top).resolve() != folder.resolve():
        return {"revision": None, "dirty": None}
    changes = _git(folder, "status", "--porcelain", "--untracked-files=normal", "--", ".", ":!results")
    return {"revision": revision, "dirty": None if changes is None else bool(changes)}


def write_json(path: str | os.PathLike[str], obj: Any) -> None:
    """Write JSON in one step: the old file stays until the new one is whole on the disk.

    Dataclasses, NamedTuples, paths, NumPy and JAX values are converted. JSON has no NaN and no infinity: both become
    null. One key a line, and a list of numbers on one line, so that a difference can be read.

    Raises:
        ValueError: If a value has no JSON form, naming its type.
        OSError: If the file cannot be written; the old one is untouched.
    """
    text = _layout(jsonable(obj)) + "\n"
    with atomic_write(path) as file:
        file.write(text.encode())


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read a JSON file.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is no JSON, naming the file.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: expected JSON ({error})") from error


def jsonable(value: Any) -> Any:
    """Convert to what JSON knows.

    Raises:
        ValueError: If a value has no JSON form.

    Example:
        >>> jsonable({"a": np.arange(2), "b": float("nan")})
        {'a': [0, 1], 'b': None}
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: jsonable(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if names := getattr(value, "_fields", None):
        return {name: jsonable(getattr(value, name)) for name in names}
    if isinstance(value, list | tuple | set | frozenset):
        return [jsonable(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, np.ndarray | np.generic) or _is_jax_array(value):
        return jsonable(np.asarray(value).tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise ValueError(f"obj: expected JSON-ready values, got {type(value).__name__}")


def _is_jax_array(value: Any) -> bool:
    """Asked without importing jax: who has an array of it has done so."""
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.Array)


def _layout(value: Any, indent: str = "") -> str:
    """JSON text: dicts and lists that hold dicts take a line an entry, all else is written on one line."""
    plain = not value or not isinstance(value, dict | list)
    if plain or (isinstance(value, list) and not any(isinstance(item, dict) for item in value)):
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    deeper = indent + "  "
    if isinstance(value, list):
        lines, brackets = [_layout(item, deeper) for item in value], "[]"
    else:
        lines = [f"{json.dumps(key, ensure_ascii=False)}: {_layout(item, deeper)}" for key, item in value.items()]
        brackets = "{}"
    body = ",\n".join(deeper + line for line in lines)
    return f"{brackets[0]}\n{body}\n{indent}{brackets[1]}"


def _git(folder: Path, *arguments: str) -> str | None:
    """Output of a git command, None where git or the checkout is missing."""
    try:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _version(name: str) -> str | None:
    """Version of an installed package; open3d comes under two names and must not be imported for this."""
    for candidate in (name, f"{name}-cpu"):
        try:
            return importlib.metadata.version(candidate)
        except importlib.metadata.PackageNotFoundError:
            continue
    return None


def _cpu_model() -> str | None:
    """The processor's name, as Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or None
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), None)


def _usable_cpus() -> int | None:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def _threads() -> dict[str, str]:
    """Thread settings from the environment; flags that hold a path are left out."""
    found = {name: os.environ[name] for name in THREAD_VARIABLES if name in os.environ}
    return {name: " ".join(flag for flag in text.split() if "/" not in flag) for name, text in found.items()}


def _without_paths(value: Any) -> Any:
    """Cut absolute paths to their last part: they name a machine or its user."""
    if isinstance(value, dict):
        return {key: _without_paths(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_paths(item) for item in value]
    if isinstance(value, str) and (value.startswith(("/", "~")) or PureWindowsPath(value).is_absolute()):
        return (PurePosixPath(value) if value.startswith(("/", "~")) else PureWindowsPath(value)).name
    return value
