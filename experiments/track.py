"""Send finished runs to Weights & Biases: configuration, curves by epoch, metrics, revision.

    python -m experiments.track runs/fig13_optimizers [FOLDER ...] --project cablejax

Needs the extra `track`. Each run is one run there, by the digest of its configuration and the revision of its code, so that
sending a sweep again adds what has been finished since and doubles nothing. With WANDB_MODE=offline they are written to
./wandb, for `wandb sync` to send from a machine with a network. TensorBoard logs are left out: their curves are these.
"""

import argparse
import csv
import sys
from pathlib import Path
from typing import Any

from cablejax.io import read_json
from cablejax.optional import require
from cablejax.train.resume import CURVES
from experiments.collect import flatten
from experiments.harness.runs import RECORD


def finished_runs(folders: list[Path]) -> list[Path]:
    """Folders of all finished runs in or below some folders, by name.

    Raises:
        ValueError: If a folder is none, or holds no finished run.
    """
    found: set[Path] = set()
    for folder in folders:
        below = {path.parent for path in folder.rglob(RECORD)}
        if not below:
            raise ValueError(f"folder: expected finished runs in {folder}, found no {RECORD}")
        found |= below
    return sorted(found)


def curves(folder: Path) -> list[dict[str, float]]:
    """The numbers of each epoch that a training left; none where nothing was trained."""
    path = folder / CURVES
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [{key: float(value) for key, value in row.items() if value} for row in csv.DictReader(file)]


def numbers(metrics: dict[str, Any]) -> dict[str, float]:
    """Single numbers among a run's metrics, by dotted key; lists and text stay in `run.json`."""
    return {
        key: value
        for key, value in flatten(metrics).items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def send(folder: Path, project: str) -> None:
    """Send one run.

    Args:
        folder: With `run.json`, and `curves.csv` where something was trained.
        project: Where it goes.
    """
    import wandb

    record = read_json(folder / RECORD)
    label, _, digest = folder.name.rpartition("-")
    run = wandb.init(
        project=project,
        name=label or digest,
        id=f"{digest}-{record['code_revision'].rstrip('+')[:12]}",
        group=record["experiment"],
        resume="allow",
        config={**flatten(record["config"]), "code_revision": record["code_revision"]},
    )
    for row in curves(folder):
        run.log(row, step=int(row["epoch"]))
    run.summary.update({**numbers(record["metrics"]), "seconds": record["seconds"]})
    run.finish()


def main() -> int:
    """Send what has not been sent; exit code 2 where a folder holds no run."""
    parser = argparse.ArgumentParser(prog="python -m experiments.track", description="Send runs to Weights & Biases.")
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="runs, or folders of runs")
    parser.add_argument("--project", default="cablejax")
    options = parser.parse_args()
    require("wandb", why="sending runs to Weights & Biases")
    try:
        runs = finished_runs(options.folders)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    for number, folder in enumerate(runs, start=1):
        print(f"{number} of {len(runs)}: {folder.name}", flush=True)
        send(folder, options.project)
    return 0


if __name__ == "__main__":
    sys.exit(main())
