"""Fold the finished runs of the study, complete stages only, into one results file a part.

    python -m experiments.study_results [--part standard_nofit ...] [--log results/study] [--take FOLDER] [--out results]

An arm is in the file from the stage on that is complete for it: as the study goes on, the files grow. With `--take` nothing is
folded: the runs of another checkout's results/study that are not here yet are brought in.
"""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cablejax.io import write_json
from experiments import ROOT, study
from experiments.analysis.statistics import fluctuation_of_updates
from experiments.collect import CollectError, flatten
from experiments.harness import run_log
from experiments.material.study_plan import FINAL, PARTS, Job, complete, config_of, name_of

LEFT_OUT = ("history", "learning_rate", "first_losses", "losses")


def row_of(job: Job, record: dict[str, Any], *, updates: int) -> dict[str, Any]:
    """What is kept of a run of so many updates an epoch; the history by column, of the losses how much they fluctuate."""
    metrics = record["metrics"]
    rough = {"fluctuation": fluctuation_of_updates(metrics["losses"], updates)} if metrics.get("losses") else {}
    return {
        **job._asdict(),
        "learning_rate": metrics["learning_rate"],
        "options": record["options"],
        **{key: value for key, value in metrics.items() if key not in LEFT_OUT},
        **rough,
        "cpu_seconds": record["cpu_seconds"],
        "history": {key: [epoch[key] for epoch in metrics["history"]] for key in run_log.COLUMNS},
    }


def fold(part: str, *, size: str, log: Path, out: Path) -> Path:
    """Write `<out>/study_<part>.json`.

    Raises:
        CollectError: If no stage of any arm is complete.
    """
    done = study.finished(part, size=size, log=log)
    kept = complete(part, done)
    if not kept:
        old = len(run_log.lines(log / f"{part}.jsonl")) - len(done)
        raise CollectError(
            f"{part}: no stage of any arm is complete; run `make study`"
            + (f" ({old} runs of other sources: `python -m experiments.verify study` replays one)" if old else "")
        )
    records = [done[job] for job in kept]
    flat = [flatten(asdict(config_of(part, job, size=size))) for job in kept]
    shared = {key: value for key, value in flat[0].items() if all(key in each and each[key] == value for each in flat)}
    origins = run_log.origins(log)["origins"]
    path = out / f"{name_of(part)}.json"
    write_json(path, {
        "experiment": name_of(part),
        "size": size,
        "seeds": sorted({job.seed for job in kept}),
        "code_revision": records[-1]["revision"],
        "seconds": round(sum(record["cpu_seconds"] for record in records), 1),
        "provenance": {key: value for key, value in origins[records[-1]["origin"]].items() if key != "sources"},
        "config": {key: value for key, value in shared.items() if key != "out"},
        "arms": list(PARTS[part].arms),
        "own": next(iter(PARTS[part].arms)),
        "target": PARTS[part].target,
        "updates_per_epoch": updates_per_epoch(part, shared),
        "missing": sum(len(PARTS[part].final) for arm in PARTS[part].arms) - sum(job.stage == FINAL for job in kept),
        "runs": [row_of(job, record, updates=updates_per_epoch(part, shared)) for job, record in zip(kept, records, strict=True)],
    })  # fmt: skip
    return path


def updates_per_epoch(part: str, config: dict[str, Any]) -> int:
    """Updates an epoch of all arms but gradient descent on the whole set, which does one."""
    classes = PARTS[part].classes if PARTS[part].module != "experiments.train" else len(config["dataset.sizes_mm2"])
    return classes * config["dataset.train_per_class"] // config["training.batch_size"]


def take(part: str, *, log: Path, other: Path) -> int:
    """Bring in the runs of another log that are not in this one; how many.

    Raises:
        CollectError: If it is of another place than it should be.
    """
    if not (other / run_log.ORIGINS).is_file():
        raise CollectError(f"--take: expected a folder with {run_log.ORIGINS}, got {other}")
    known, origins = run_log.lines(log / f"{part}.jsonl"), run_log.origins(other)["origins"]
    new = [line for line in run_log.lines(other / f"{part}.jsonl") if line not in known]
    for line in new:
        run_log.register(log, origins[line["origin"]])
        run_log.append(log / f"{part}.jsonl", line)
    run_log.accept_all(log, run_log.origins(other)["accepted"])
    return len(new)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m experiments.study_results", description="Fold the study's runs.")
    parser.add_argument("--part", nargs="+", choices=tuple(PARTS), default=list(PARTS), metavar="PART")
    parser.add_argument("--size", default="quick", choices=("smoke", "quick"))
    parser.add_argument("--log", type=Path, default=study.LOG)
    parser.add_argument(
        "--take", type=Path, metavar="FOLDER", help="another checkout's results/study, to take runs from; folds nothing"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "results")
    options = parser.parse_args()
    written = 0
    for part in options.part:
        try:
            if options.take is not None:
                print(f"{part}: {take(part, log=options.log, other=options.take)} runs taken")
                written += 1
                continue
            print(fold(part, size=options.size, log=options.log, out=options.out))
            written += 1
        except (CollectError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
    sys.exit(0 if written else 1)


if __name__ == "__main__":
    main()
