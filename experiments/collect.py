"""Fold the runs of an experiment into one results file.

    python -m experiments.collect table1_filtering --size quick --out results

A results file is made from one revision of the code and from the same seeds in every cell, or not at all.
"""

import argparse
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

from cablejax.io import read_json, write_json
from experiments.harness.revision import is_clean
from experiments.harness.runs import RECORD

Record = dict[str, Any]
ABSENT = object()  # what a key is in a run that has none: another filter's, which None would hide


class CollectError(Exception):
    """The runs at hand can't be folded into one results file."""


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested keys joined by dots.

    Example:
        >>> flatten({"filter": {"k": 20}, "seed": 0})
        {'filter.k': 20, 'seed': 0}
    """
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat


def read_records(folder: Path, *, revision: str | None = None) -> list[Record]:
    """Every finished run below a folder, of one revision only where one is asked for.

    Raises:
        CollectError: If there is none, or if they come from several revisions.
    """
    records = [_read(path) for path in sorted(folder.glob(f"*/{RECORD}"))]
    if revision is not None:
        records = [record for record in records if record["code_revision"] == revision]
    if not records:
        raise CollectError(f"no finished run in {folder}" + (f" at revision {revision}" if revision else ""))
    revisions = defaultdict(int)
    for record in records:
        revisions[record["code_revision"]] += 1
    if len(revisions) > 1:
        counts = ", ".join(f"{count} at {name}" for name, count in sorted(revisions.items()))
        raise CollectError(f"mixed revisions in {folder}: {counts}. Run the sweep again or choose one with --revision")
    return records


def _read(path: Path) -> Record:
    try:
        return read_json(path)
    except ValueError as error:
        raise CollectError(f"{path}: no record; the same sweep makes it anew ({error})") from error


def cells(records: list[Record]) -> list[dict[str, Any]]:
    """One entry per run: the keys that differ between runs, the seed, the metrics.

    Raises:
        CollectError: If some combination of keys lacks a seed that another has.
    """
    flat = [flatten(record["config"]) for record in records]
    keys = sorted(set().union(*flat))
    varying = [k for k in keys if k != "seed" and len({repr(f.get(k, ABSENT)) for f in flat}) > 1]
    rows = [
        {"cell": {k: f[k] for k in varying if k in f}, "seed": record["seed"], "metrics": record["metrics"]}
        for f, record in zip(flat, records, strict=True)
    ]
    seeds: dict[str, set[int]] = defaultdict(set)
    for row in rows:
        seeds[repr(row["cell"])].add(row["seed"])
    everything = set().union(*seeds.values())
    missing = {cell: sorted(everything - have) for cell, have in seeds.items() if have != everything}
    if missing:
        text = "; ".join(f"{cell} lacks seed {', '.join(map(str, left))}" for cell, left in missing.items())
        raise CollectError(f"missing seeds: {text}")
    return sorted(rows, key=lambda row: (repr(row["cell"]), row["seed"]))


def collect(experiment: str, *, size: str, runs: Path, out: Path, revision: str | None, allow_dirty: bool) -> Path:
    """Write `<out>/<experiment>.json` from the finished runs below `<runs>/<experiment>/<size>`.

    Args:
        experiment: Name of the experiment, which is also that of its configuration, folder and results file.
        size: smoke, quick or paper.
        runs: Folder of the runs.
        out: Folder of the results.
        revision: Only runs of this code revision; None accepts any, if they all share it.
        allow_dirty: Also take runs of code that was not committed.

    Raises:
        CollectError: If there are no runs, revisions are mixed, seeds are missing, or the code was not committed.
    """
    records = read_records(runs / experiment / size, revision=revision)
    first = records[0]
    if not allow_dirty and not is_clean(first["code_revision"]):
        raise CollectError(f"{experiment}: made by uncommitted code ({first['code_revision']}); commit and run again")
    rows = cells(records)
    varying = set().union(*(row["cell"] for row in rows))
    fixed = {k: v for k, v in flatten(first["config"]).items() if k not in varying and k != "seed"}
    result = {
        "experiment": experiment,
        "size": size,
        "seeds": sorted({row["seed"] for row in rows}),
        "code_revision": first["code_revision"],
        "seconds": round(sum(record["seconds"] for record in records), 1),
        # The code revision, taken when the code was loaded, says more than the work tree at the end of the first run.
        "provenance": {k: v for k, v in first["provenance"].items() if k not in ("seeds", "git")},
        "config": fixed,
        "runs": rows,
    }
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{experiment}.json"
    write_json(path, result)
    return path


def main(arguments: list[str] | None = None) -> None:
    """Command line: `python -m experiments.collect NAME [NAME ...] [--size SIZE] [--out FOLDER]`."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.collect", description="Fold the runs of an experiment into one results file."
    )
    parser.add_argument("experiment", nargs="+")
    parser.add_argument("--size", default="quick", choices=("smoke", "quick", "paper"))
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--revision", help="only runs made by this code revision")
    parser.add_argument("--allow-dirty", action="store_true", help="also take runs of uncommitted code")
    options = parser.parse_args(arguments)
    for experiment in options.experiment:
        try:
            path = collect(
                experiment,
                size=options.size,
                runs=options.runs,
                out=options.out,
                revision=options.revision,
                allow_dirty=options.allow_dirty,
            )
        except (CollectError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(1)
        print(path)


if __name__ == "__main__":
    main()
