"""Finished runs as lines of a committed file, each with what made it, and which of them the present sources still stand for.

`<folder>/<part>.jsonl` holds one run a line. `<folder>/origins.json` holds what the lines refer to: the digests of the
sources, versions and processor that made runs, and which sources a replay has shown to give the same numbers as others.
"""

import json
from dataclasses import asdict
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from cablejax.io import provenance, read_json, write_json
from experiments.harness.revision import code_revision
from experiments.harness.schema import Config
from experiments.harness.sources import combined, present

ORIGINS = "origins.json"
COLUMNS = ("train_loss", "validation_loss", "validation_overall", "seconds")
FIRST = 2
LEFT_OUT = ("history", "test_confusion", "labels_mm2", "classes")
# Keys younger than the first runs, with the value that stands for what was done before there was the key.
ADDED = {"dataset": {"pool": None}, "parts": {"mix": "cables"}}
NOT_COMPARED = ("out", "name")  # of a configuration: where a run is written, and under what name

Line = dict[str, Any]


def config_digest(cfg: Config) -> str:
    """Of everything in a configuration that can change a number."""
    plain = {key: value for key, value in asdict(cfg).items() if key not in NOT_COMPARED}
    for group, keys in ADDED.items():
        plain[group] = {key: value for key, value in plain[group].items() if key not in keys or value != keys[key]}
    return sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:12]


def lines(path: Path) -> list[Line]:
    """The runs of a file, none where there is no file; a line that a kill cut off is none.

    Raises:
        ValueError: If another line than the last is no JSON.
    """
    rows = path.read_text().splitlines() if path.is_file() else []
    found = []
    for number, row in enumerate(rows, 1):
        try:
            found.append(json.loads(row))
        except ValueError as error:
            if number < len(rows):
                raise ValueError(f"{path}: line {number} is no run ({error})") from None
    return found


def append(path: Path, line: Line) -> None:
    """Add a run, on a line of its own also behind one that was cut off."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = path.read_bytes() if path.is_file() else b""
    if not kept.endswith(b"\n"):
        path.write_bytes(kept[: kept.rfind(b"\n") + 1])
    with path.open("a") as file:
        file.write(json.dumps(line, separators=(",", ":")) + "\n")


def compact(metrics: dict[str, Any], *, losses: bool = False) -> dict[str, Any]:
    """Metrics as a line keeps them: numbers of five digits, the history by column, no confusions.

    Args:
        metrics: Of `experiments.train` or `experiments.pretrain`.
        losses: Whether the loss of every update is kept, of four digits.
    """
    kept = {key: _rounded(value) for key, value in metrics.items() if key not in LEFT_OUT}
    history = {key: [_rounded(epoch[key]) for epoch in metrics["history"]] for key in COLUMNS}
    if losses:
        kept["losses"] = [float(f"{loss:.4g}") for epoch in metrics["history"] for loss in epoch["losses"]]
    return kept | {"history": history, "first_losses": first_losses(metrics["history"])}


def first_losses(history: list[dict[str, Any]]) -> list[float]:
    """Losses of the first updates, of eight digits: what two versions of the sources are compared by."""
    return [float(f"{loss:.8g}") for loss in history[0]["losses"][:FIRST]] if history else []


def expanded(kept: dict[str, Any]) -> dict[str, Any]:
    """Metrics from a line: the history one record an epoch again."""
    columns = kept["history"]
    rows = zip(*(columns[key] for key in COLUMNS), strict=True)
    history = [{"epoch": epoch, **dict(zip(COLUMNS, row, strict=True))} for epoch, row in enumerate(rows, 1)]
    return {**kept, "history": history}


def _rounded(value: Any) -> Any:
    return float(f"{value:.5g}") if isinstance(value, float) else value


@cache
def origin(module: str, unused: tuple[str, ...]) -> dict[str, Any]:
    """What makes runs of a module here and now."""
    made = provenance(seeds=[])
    kept = {key: made[key] for key in ("versions", "python", "cpu", "device")}
    return {"sources": present(module, unused), "revision": code_revision(), **kept}


def register(folder: Path, what: dict[str, Any]) -> str:
    """The name of an origin, written to `origins.json` if it is not there."""
    name = sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:12]
    known = origins(folder)
    if name not in known["origins"]:
        known["origins"][name] = what
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / ORIGINS, known)
    return name


def origins(folder: Path) -> dict[str, Any]:
    """Contents of `origins.json`: `origins` by name, and `accepted`, pairs of sources that give the same numbers."""
    path = folder / ORIGINS
    return read_json(path) if path.is_file() else {"origins": {}, "accepted": []}


def accept(folder: Path, sources: dict[str, str], as_good_as: str, evidence: dict[str, Any]) -> None:
    """Keep that sources were seen to give the numbers of others.

    Args:
        folder: Of the log.
        sources: The new ones' digests.
        as_good_as: The old ones' combined digest.
        evidence: Which run was replayed, and by how much it differed.
    """
    accept_all(folder, [{"sources": combined(sources), "as": as_good_as, **evidence}])


def accept_all(folder: Path, pairs: list[dict[str, Any]]) -> None:
    """Keep what was accepted, with its evidence, where it is not kept yet."""
    known = origins(folder)
    new = [pair for pair in pairs if pair not in known["accepted"]]
    if new:
        write_json(folder / ORIGINS, {**known, "accepted": known["accepted"] + new})


def equivalent(folder: Path, sources: dict[str, str]) -> set[str]:
    """Combined digests of the sources that give the same numbers as these, themselves included."""
    found, pairs = {combined(sources)}, [{each["sources"], each["as"]} for each in origins(folder)["accepted"]]
    while grown := [pair for pair in pairs if pair & found and not pair <= found]:
        found = found.union(*grown)
    return found


def current(folder: Path, rows: list[Line], sources: dict[str, str]) -> list[Line]:
    """The runs that sources which give the same numbers as these have made."""
    good, known = equivalent(folder, sources), origins(folder)["origins"]
    return [row for row in rows if row["origin"] in known and combined(known[row["origin"]]["sources"]) in good]


def stale(folder: Path, rows: list[Line], sources: dict[str, str]) -> list[Line]:
    """The other ones."""
    kept = current(folder, rows, sources)
    return [row for row in rows if row not in kept]


def changed(folder: Path, row: Line, sources: dict[str, str]) -> list[str]:
    """Modules whose digests differ between what made a run and these."""
    old = origins(folder)["origins"].get(row["origin"], {"sources": {}})["sources"]
    return sorted(name for name in {*old, *sources} if old.get(name) != sources.get(name))
