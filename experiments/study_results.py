"""Fold the finished runs of the study, complete stages only, into one results file a part.

    python -m experiments.study_results [--part standard_nofit ...] [--size quick] [--out results]

An arm is in the file from the stage on that is complete for it: as the study goes on, the files grow.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from cablejax.io import write_json
from experiments import ROOT, study
from experiments.collect import CollectError, flatten
from experiments.harness.revision import code_revision, is_clean
from experiments.study import CONFIRM, FINAL, PAPER_WAY, PARTS, SEARCH, Job, Records

KEPT = ("epoch", "train_loss", "validation_loss", "validation_overall", "seconds")
LEFT_OUT = ("test_confusion", "labels_mm2", "classes", "history")


def complete(part: str, done: Records) -> list[Job]:
    """The jobs of every stage that an arm has finished wholly, in the study's order."""
    this = PARTS[part]
    kept = []
    for arm in this.optimizers:
        best, trial = study.confirmed(part, arm, done), study.chosen(part, arm, done)
        if best is None:
            continue
        kept += [Job(SEARCH, arm, each, 0) for each in range(this.trials)]
        if trial is None:
            continue
        kept += [Job(CONFIRM, arm, each, seed) for each in best for seed in this.confirm]
        final = [Job(FINAL, arm, trial, seed) for seed in this.final]
        kept += final if all(job in done for job in final) else []
    paper = [Job(FINAL, PAPER_WAY, 0, seed) for seed in this.final]
    return kept + (paper if all(job in done for job in paper) else [])


def row_of(job: Job, record: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a run."""
    config, metrics = record["config"], record["metrics"]
    return {
        "stage": job.stage,
        "arm": job.arm,
        "trial": job.trial,
        "seed": job.seed,
        "options": config["optimizer"]["options"],
        **{key: value for key, value in metrics.items() if key not in LEFT_OUT},
        "history": [{key: epoch[key] for key in KEPT} for epoch in metrics["history"]],
    }


def fold(part: str, *, size: str, runs: Path, out: Path, allow_dirty: bool = False) -> Path:
    """Write `<out>/study_<part>.json`.

    Raises:
        CollectError: If no stage of any arm is complete, or the code was not committed.
    """
    done = study.finished(part, size=size, out=runs)
    kept = complete(part, done)
    if not kept:
        raise CollectError(
            f"{part}: no stage of any arm is complete at revision {code_revision()[:12]}; run `make study`"
        )
    if not allow_dirty and not is_clean(code_revision()):
        raise CollectError(f"{part}: made by uncommitted code ({code_revision()}); commit and run again")
    records = [done[job] for job in kept]
    flat = [flatten(record["config"]) for record in records]
    shared = {key: value for key, value in flat[0].items() if all(key in each and each[key] == value for each in flat)}
    path = out / f"{study.name_of(part)}.json"
    write_json(path, {
        "experiment": study.name_of(part),
        "size": size,
        "seeds": sorted({job.seed for job in kept}),
        "code_revision": code_revision(),
        "seconds": round(sum(record["seconds"] for record in records), 1),
        "provenance": {k: v for k, v in records[0]["provenance"].items() if k not in ("seeds", "git")},
        "config": shared,
        "target": PARTS[part].target,
        "updates_per_epoch": updates_per_epoch(part, shared),
        "runs": [row_of(job, record) for job, record in zip(kept, records, strict=True)],
    })  # fmt: skip
    return path


def updates_per_epoch(part: str, config: dict[str, Any]) -> int:
    """Updates an epoch of all arms but gradient descent on the whole set, which does one."""
    classes = PARTS[part].classes if PARTS[part].module != "experiments.train" else len(config["dataset.sizes_mm2"])
    return classes * config["dataset.train_per_class"] // config["training.batch_size"]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m experiments.study_results", description="Fold the study's runs.")
    parser.add_argument("--part", nargs="+", choices=tuple(PARTS), default=list(PARTS), metavar="PART")
    parser.add_argument("--size", default="quick", choices=("smoke", "quick"))
    parser.add_argument("--runs", type=Path, default=ROOT / "runs")
    parser.add_argument("--out", type=Path, default=ROOT / "results")
    parser.add_argument("--allow-dirty", action="store_true", help="also take runs of uncommitted code")
    options = parser.parse_args()
    written = 0
    for part in options.part:
        try:
            print(fold(part, size=options.size, runs=options.runs, out=options.out, allow_dirty=options.allow_dirty))
            written += 1
        except (CollectError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
    sys.exit(0 if written else 1)


if __name__ == "__main__":
    main()
