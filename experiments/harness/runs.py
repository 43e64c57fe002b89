"""A run: one configuration in one folder, done once, kept with its provenance, and gone on with after a kill."""

import hashlib
import json
import re
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path
from typing import Any

from cablejax.io import provenance, read_json, write_json
from experiments.harness.revision import code_revision
from experiments.harness.schema import Config

RECORD = "run.json"
BEGUN = "begun.json"

Task = Callable[[Config, Path], dict[str, Any]]


def identity(cfg: Config) -> dict[str, Any]:
    """Everything in a configuration that can change a number: all of it but the place it is written to."""
    plain = asdict(cfg)
    del plain["out"]
    return plain


def run_folder(cfg: Config, *, label: str = "") -> Path:
    """The folder of a run, found again by the digest of its configuration; `label` makes a new one readable."""
    digest = hashlib.sha256(json.dumps(identity(cfg), sort_keys=True).encode()).hexdigest()[:12]
    parent = Path(cfg.out) / cfg.name / cfg.size
    existing = sorted(parent.glob(f"*{digest}")) if parent.is_dir() else []
    readable = re.sub(r"[^A-Za-z0-9.=,_-]+", "_", label)[:80]
    return existing[0] if existing else parent / (f"{readable}-{digest}" if readable else digest)


def finished(folder: Path) -> dict[str, Any] | None:
    """The record of a run that the present code finished, else None."""
    path = folder / RECORD
    if not path.is_file():
        return None
    record = _read(path)
    return record if record is not None and record["code_revision"] == code_revision() else None


def _read(path: Path) -> dict[str, Any] | None:
    """A record that a run left; None, and the file set aside under another name, where it is none: a full disk empties files."""
    try:
        record = read_json(path)
        if isinstance(record, dict) and "code_revision" in record:
            return record
    except ValueError:
        pass
    kept = _free(path.with_name(f"{path.name}.broken"))
    path.rename(kept)
    print(f"{path}: holds no record; kept as {kept.name} and made anew", file=sys.stderr, flush=True)
    return None


def _free(path: Path) -> Path:
    """The path, or with a number behind it the first one that is not taken."""
    names = chain([path.name], (f"{path.name}{i}" for i in count(2)))
    return next(each for each in map(path.with_name, names) if not each.exists())


def _clear(folder: Path) -> None:
    """Empty a folder that other code began. Where it is not known which code did, it is kept under another name."""
    begun = folder / BEGUN
    if not folder.is_dir():
        return
    record = _read(begun) if begun.is_file() else None
    if record is not None and record["code_revision"] == code_revision():
        return
    if any(folder.glob(f"{BEGUN}.broken*")):
        folder.rename(_free(folder.with_name(f"{folder.name}.broken")))
    else:
        shutil.rmtree(folder)


def execute(task: Task, cfg: Config, *, label: str = "") -> tuple[dict[str, Any], bool]:
    """Run a task in its folder, or return what an earlier run of the same code and configuration left.

    A folder begun by other code is emptied first: its checkpoints belong to other numbers. Records that cannot be read are
    made anew and the old ones kept beside.

    Args:
        task: Takes the configuration and the run's folder, returns metrics that JSON can hold.
        cfg: The whole configuration.
        label: Readable start of the folder's name.

    Returns:
        The record, and whether it was there already.
    """
    folder = run_folder(cfg, label=label)
    record = finished(folder)
    if record is not None:
        return record, True
    _clear(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"out: expected a folder that can be written, got {cfg.out} ({error.strerror})") from None
    write_json(folder / BEGUN, {"code_revision": code_revision(), "config": identity(cfg)})
    start = time.perf_counter()
    metrics = task(cfg, folder)
    record = {
        "experiment": cfg.name,
        "size": cfg.size,
        "seed": cfg.seed,
        "code_revision": code_revision(),
        "config": identity(cfg),
        "metrics": metrics,
        "seconds": round(time.perf_counter() - start, 3),
        "provenance": provenance(seeds=[cfg.seed]),
    }
    write_json(folder / RECORD, record)
    return record, False
