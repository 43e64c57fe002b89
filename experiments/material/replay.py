"""The first epoch of a finished run of the study again: do changed sources still give its numbers?"""

import importlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from experiments.harness import run_log
from experiments.harness.run_log import Line
from experiments.harness.sources import combined, present
from experiments.material.study_plan import PARTS, SEARCH, Job, config_of

COMPARED = ("train_loss", "validation_loss")
# Relative. See docs/study.md: rounding alone moves the training loss of a first epoch by less, any other order of clouds,
# weights or rate by more.
TOLERANCE = {"train_loss": 0.002, "validation_loss": 0.05}


def sample(rows: list[Line]) -> Line | None:
    """The run to repeat: of the search, which tests nothing; the one that learnt most."""
    found = [row for row in rows if row["stage"] == SEARCH and row["metrics"]["history"]["train_loss"]]
    return max(found, key=lambda row: row["metrics"]["validation_overall"], default=None)


def replay(part: str, row: Line) -> dict[str, float]:
    """Relative differences of the first epoch's losses between a run and what these sources make of its job.

    Raises:
        ValueError: If the job is no longer configured as it was: no replay can stand for it then.
    """
    job = Job(row["stage"], row["arm"], row["trial"], row["seed"])
    cfg = config_of(part, job, size=row["size"])
    if run_log.config_digest(cfg) != row["config"]:
        raise ValueError(f"{part}: {job.label} is configured otherwise now; its runs must be made anew")
    training = replace(cfg.training, give_up_epoch=1, give_up_loss=float("-inf"))
    again = importlib.import_module(PARTS[part].module).measured(replace(cfg, training=training))["history"][0]
    old = row["metrics"]["history"]
    return {key: abs(again[key] / old[key][0] - 1.0) for key in COMPARED}


def verify_part(part: str, log: Path, say: Callable[[str], None]) -> bool:
    """Replay a run of each other version of the sources, and accept the present ones where they agree; whether all did."""
    sources = present(PARTS[part].module, PARTS[part].unused)
    rows = run_log.lines(log / f"{part}.jsonl")
    if not rows:
        return True
    while left := run_log.stale(log, rows, sources):
        row = sample(left)
        if row is None:
            say(f"{part}: {len(left)} runs of other sources, none of them a search run that could be replayed")
            return False
        found = replay(part, row)
        told = ", ".join(f"{key} differs by {value:.1e} of itself" for key, value in found.items())
        label = Job(row["stage"], row["arm"], row["trial"], row["seed"]).label
        if any(not value <= TOLERANCE[key] for key, value in found.items()):
            names = ", ".join(run_log.changed(log, row, sources))
            say(f"{part}: differs\n  {label}: {told}; of its sources changed: {names}")
            return False
        old = combined(run_log.origins(log)["origins"][row["origin"]]["sources"])
        run_log.accept(
            log, sources, old, {"run": f"{part}: {label}", **{k: float(f"{v:.1e}") for k, v in found.items()}}
        )
        say(f"{part}: the same within its tolerance ({label}: {told}); the present sources accepted")
    say(f"{part}: {len(rows)} runs stand for the present sources")
    return True
