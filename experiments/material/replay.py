"""The first updates of a finished run of the study again: do changed sources still give its numbers?

The loss of the first update tells of the clouds, the initial weights and the forward pass, that of the second one of the
gradient, the optimizer, its rate and second number, and clipping. Later ones tell little: rounding grows from update to
update, and by the end of an epoch at a high rate it is as large as what another rate would do.
"""

import importlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from experiments.harness import run_log
from experiments.harness.run_log import Line
from experiments.harness.sources import combined, present
from experiments.material.study_plan import PARTS, SEARCH, Job, config_of

# Relative, of the loss of the first and the second update. Measured: docs/study.md.
TOLERANCE = (1e-5, 1e-5)


def sample(rows: list[Line]) -> Line | None:
    """The run to repeat: of the search, which tests nothing; the one that learnt most."""
    found = [row for row in rows if row["stage"] == SEARCH and row["metrics"].get("first_losses")]
    return max(found, key=lambda row: row["metrics"]["validation_overall"], default=None)


def replay(part: str, row: Line) -> list[float]:
    """Relative differences of the first updates' losses between a run and what these sources make of its job.

    Raises:
        ValueError: If the job is no longer configured as it was: no replay can stand for it then.
    """
    job = Job(row["stage"], row["arm"], row["trial"], row["seed"])
    cfg = config_of(part, job, size=row["size"])
    if run_log.config_digest(cfg) != row["config"]:
        raise ValueError(f"{part}: {job.label} is configured otherwise now; its runs must be made anew")
    training = replace(cfg.training, give_up_epoch=1, give_up_loss=float("-inf"))
    history = importlib.import_module(PARTS[part].module).measured(replace(cfg, training=training))["history"]
    pairs = zip(run_log.first_losses(history), row["metrics"]["first_losses"], strict=True)
    return [abs(again / old - 1.0) for again, old in pairs]


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
        told = "the first losses differ by " + ", ".join(f"{value:.1e}" for value in found) + " of themselves"
        label = Job(row["stage"], row["arm"], row["trial"], row["seed"]).label
        if any(not value <= allowed for value, allowed in zip(found, TOLERANCE, strict=True)):
            names = ", ".join(run_log.changed(log, row, sources))
            say(f"{part}: differs\n  {label}: {told}; of its sources changed: {names}")
            return False
        old = combined(run_log.origins(log)["origins"][row["origin"]]["sources"])
        run_log.accept(
            log, sources, old, {"run": f"{part}: {label}", "differs": [float(f"{each:.1e}") for each in found]}
        )
        say(f"{part}: the same within its tolerance ({label}: {told}); the present sources accepted")
    say(f"{part}: {len(rows)} runs stand for the present sources")
    return True
