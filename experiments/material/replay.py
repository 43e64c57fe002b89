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
LEARNT = 0.4  # of the accuracy of the run that learnt most


def samples(rows: list[Line]) -> list[Line]:
    """Runs to repeat until one agrees: of the search, which tests nothing; of each arm the slowest rate that still learnt.

    On another processor the second loss of a quick one may move by more than the tolerance: by 1.4e-4 of itself under Adadelta at
    rate 3, by 3e-5 under mini-batch descent at rate 1, and by 3e-6 and 3e-7 at rates 1 and .01. One that agrees will do, as
    none would agree with other sources.
    """
    found = [row for row in rows if row["stage"] == SEARCH and row["metrics"].get("first_losses")]
    most = max((row["metrics"]["validation_overall"] for row in found), default=0.0)
    slowest: dict[str, Line] = {}
    for row in sorted(found, key=lambda row: row["metrics"]["learning_rate"]):
        if row["metrics"]["validation_overall"] >= LEARNT * most:
            slowest.setdefault(row["arm"], row)
    return list(slowest.values())


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
        found = samples(left)
        if not found:
            say(f"{part}: {len(left)} runs of other sources, none of them a search run that could be replayed")
            return False
        for row in found:
            differs = replay(part, row)
            told = "the first losses differ by " + ", ".join(f"{value:.1e}" for value in differs) + " of themselves"
            label = Job(row["stage"], row["arm"], row["trial"], row["seed"]).label
            if all(value <= allowed for value, allowed in zip(differs, TOLERANCE, strict=True)):
                break
            say(f"{part}: {label}: {told}")
        else:
            names = ", ".join(run_log.changed(log, found[0], sources))
            say(f"{part}: differs; of its sources changed: {names}")
            return False
        old = combined(run_log.origins(log)["origins"][row["origin"]]["sources"])
        run_log.accept(
            log, sources, old, {"run": f"{part}: {label}", "differs": [float(f"{each:.1e}") for each in differs]}
        )
        say(f"{part}: the same within its tolerance ({label}: {told}); the present sources accepted")
    say(f"{part}: {len(rows)} runs stand for the present sources")
    return True
