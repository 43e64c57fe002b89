"""Run what is missing of the study: search, confirm and final runs of every optimizer, part by part.

    python -m experiments.study [--part standard_nofit ...] [--size quick] [--dry]

Each job is a command that can be run by hand, in a process of its own pinned to one core, with a log of its own. Killed at any
time, the same command goes on. docs/study.md is the protocol.
"""

import argparse
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.io import read_json
from experiments import ROOT
from experiments.harness.revision import code_revision
from experiments.harness.runs import RECORD

OPTIMIZERS = ("adadelta", "sgd", "mbgd", "adagrad", "rmsprop", "adam", "adamw", "schedule_free", "muon")
SEARCH, CONFIRM, FINAL = "search", "confirm", "final"
PAPER_WAY = "adadelta_paper"  # rate 1, no warm-up, no clipping, a constant rate; not tuned
CONFIRMED = 3  # trials that go on to the confirm stage
INTERRUPTED = 130


@dataclass(frozen=True)
class Part:
    """One workload with one arm of the answer in the input.

    Attributes:
        overrides: What sets it apart from conf/experiment/study.yaml.
        target: Validation accuracy whose first epoch is counted.
        minutes: Of a run at size=quick on one core, for the dry run where none is done yet.
        module: What trains.
        optimizers: Whom it compares.
        trials: Of the search stage.
        confirm: Seeds of the confirm stage.
        final: Seeds of the final stage.
        classes: For the loss of a guess; 3 sizes at size=smoke.
    """

    overrides: tuple[str, ...]
    target: float
    minutes: float
    module: str = "experiments.train"
    optimizers: tuple[str, ...] = OPTIMIZERS
    trials: int = 16
    confirm: tuple[int, ...] = (1, 2)
    final: tuple[int, ...] = tuple(range(10, 20))
    classes: int = 13
    epochs: int = 32


NO_FIT = ("dataset=standard", "variant=pose_none")
PARTS = {
    "standard_nofit": Part(NO_FIT, 0.95, 6.0),
    "standard_fit": Part(("dataset=standard",), 0.95, 6.0),
    "hard_nofit": Part(("dataset=hard", "variant=pose_none", "dataset.n_points=512"), 0.5, 12.0),
    # 42 clouds of each of ten classes an epoch, pass after pass: 17 batches of 24, as in the other parts.
    "modelnet10": Part(("dataset.train_per_class=42",), 0.9, 6.0, module="experiments.pretrain", classes=10),
    # As many updates as the others take, each with the gradient of the whole epoch's clouds.
    "gradient_descent": Part(
        NO_FIT, 0.95, 100.0, optimizers=("sgd",), trials=4, confirm=(), final=(10, 11, 12), epochs=544
    ),
}


@dataclass(frozen=True)
class Job:
    """One run: `arm` is an optimizer, or the paper's way."""

    stage: str
    arm: str
    trial: int
    seed: int

    @property
    def label(self) -> str:
        return f"{self.stage} {self.arm} trial {self.trial} seed {self.seed}"


Records = dict[Job, dict[str, Any]]


def name_of(part: str) -> str:
    """The experiment's name of a part, which is that of its folder and results file."""
    return f"study_{part}"


def overrides(part: str, job: Job, *, size: str, out: Path) -> list[str]:
    """The command line of a job after `python -m <module>`."""
    this = PARTS[part]
    epochs = 2 if size == "smoke" else this.epochs
    classes = 3 if size == "smoke" and this.module == "experiments.train" else this.classes
    found = [
        "experiment=study", f"name={name_of(part)}", f"size={size}", f"out={out}", *this.overrides,
        f"seed={job.seed}", f"dataset.seed={job.seed}", f"trial={job.trial}", f"training.epochs={epochs}",
        f"training.test={str(job.stage == FINAL).lower()}",
    ]  # fmt: skip
    if job.arm == PAPER_WAY:
        return [*found, "optimizer=adadelta", "rates=stated", "training.warmup_epochs=0", "training.clip_norm=null",
                "training.schedule=constant"]  # fmt: skip
    found.append(f"optimizer={job.arm}")
    if job.arm == "schedule_free":
        found.append("training.schedule=constant")
    if job.stage != FINAL:  # a trial that is still guessing after a third of its epochs
        found += [
            f"training.give_up_epoch={max(1, epochs // 3)}",
            f"training.give_up_loss={0.98 * math.log(classes):.4g}",
        ]
    return found


def job_of(part: str, config: dict[str, Any]) -> Job:
    """The job that a run's configuration is of."""
    seed, stated = config["seed"], config["rates"] == "stated"
    stage = FINAL if seed in PARTS[part].final else CONFIRM if seed in PARTS[part].confirm else SEARCH
    return Job(stage, PAPER_WAY if stated else config["optimizer"]["name"], config["trial"], seed)


def finished(part: str, *, size: str, out: Path) -> Records:
    """The runs that the present code has finished, by job."""
    found = {}
    for path in sorted((out / name_of(part) / size).glob(f"*/{RECORD}")):
        try:
            record = read_json(path)
            if record["code_revision"] == code_revision():
                found[job_of(part, record["config"])] = record
        except (ValueError, KeyError, TypeError):
            continue  # emptied by a full disk: the job makes it anew
    return found


def score(records: Iterable[dict[str, Any]]) -> tuple[float, float]:
    """What runs are ranked by: the mean of their best validation accuracies, of equals the lower loss."""
    rows = [record["metrics"] for record in records]
    loss = [row["history"][row["best_epoch"] - 1]["validation_loss"] if row["history"] else math.inf for row in rows]
    return float(np.mean([row["validation_overall"] for row in rows])), -float(np.mean(loss))


def chosen(part: str, arm: str, done: Records) -> int | None:
    """The trial that goes to the final stage; None as long as search or confirm is not complete."""
    best = confirmed(part, arm, done)
    if best is None:
        return None
    seeds = [(SEARCH, 0), *((CONFIRM, seed) for seed in PARTS[part].confirm)]
    rows = {trial: [done.get(Job(stage, arm, trial, seed)) for stage, seed in seeds] for trial in best}
    whole = {trial: [each for each in found if each is not None] for trial, found in rows.items()}
    if any(len(found) < len(seeds) for found in whole.values()):
        return None
    return max(whole, key=lambda trial: score(whole[trial]))


def confirmed(part: str, arm: str, done: Records) -> list[int] | None:
    """The trials that go to the confirm stage, the best first; None as long as the search is not complete."""
    trials = range(PARTS[part].trials)
    found = {trial: done.get(Job(SEARCH, arm, trial, 0)) for trial in trials}
    there = {trial: record for trial, record in found.items() if record is not None}
    if len(there) < len(trials):
        return None
    return sorted(there, key=lambda trial: score([there[trial]]), reverse=True)[:CONFIRMED]


def jobs(part: str, done: Records) -> list[Job]:
    """Every job that the finished ones allow, done or not, stage by stage."""
    this = PARTS[part]
    found = [Job(SEARCH, arm, trial, 0) for trial in range(this.trials) for arm in this.optimizers]
    for arm in this.optimizers:
        found += [Job(CONFIRM, arm, trial, seed) for trial in confirmed(part, arm, done) or [] for seed in this.confirm]
    for arm in this.optimizers:
        trial = chosen(part, arm, done)
        found += [] if trial is None else [Job(FINAL, arm, trial, seed) for seed in this.final]
    if "adadelta" in this.optimizers:
        found += [Job(FINAL, PAPER_WAY, 0, seed) for seed in this.final]
    return found


def count(part: str) -> int:
    """Jobs of a part, those included that are not known yet."""
    this = PARTS[part]
    each = this.trials + CONFIRMED * len(this.confirm) + len(this.final)
    return len(this.optimizers) * each + ("adadelta" in this.optimizers) * len(this.final)


def minutes_left(part: str, done: Records, size: str) -> float:
    """Of one process: what is missing, at the mean of what was done."""
    seconds = [record["seconds"] for record in done.values()]
    each = float(np.mean(seconds)) / 60 if seconds else PARTS[part].minutes if size == "quick" else 1.0
    return (count(part) - len(done)) * each


class Runner:
    """Works off a part's jobs in processes pinned to a core each; a job that fails is named and left for the next call."""

    def __init__(self, part: str, *, size: str, out: Path, cores: list[int]):
        self.part, self.size, self.out, self.cores = part, size, out, cores
        self.done = finished(part, size=size, out=out)
        self.taken: set[Job] = set()
        self.failed: list[Job] = []
        self.running: dict[Job, subprocess.Popen[bytes]] = {}
        self.lock = threading.Condition()
        self.stopped = False

    def run(self) -> bool:
        """Whether every job of the part is done."""
        threads = [threading.Thread(target=self._work, args=(core,), daemon=True) for core in self.cores]
        for thread in threads:
            thread.start()
        try:
            for thread in threads:
                while thread.is_alive():
                    thread.join(0.5)
        except BaseException:
            with self.lock:
                self.stopped = True
                for process in self.running.values():
                    process.terminate()
                self.lock.notify_all()
            raise
        return len(self.done) >= count(self.part)

    def _next(self) -> Job | None:
        """A job that nobody has; waits where only running ones can bring more."""
        with self.lock:
            while not self.stopped:
                free = [job for job in jobs(self.part, self.done) if job not in self.done and job not in self.taken]
                if free:
                    self.taken.add(free[0])
                    return free[0]
                if not self.taken - set(self.done) - set(self.failed):
                    return None
                self.lock.wait(1.0)
            return None

    def _work(self, core: int) -> None:
        while (job := self._next()) is not None:
            logs = self.out / name_of(self.part) / "logs"
            logs.mkdir(parents=True, exist_ok=True)
            log = logs / f"{job.label.replace(' ', '_')}.txt"
            start = time.perf_counter()
            code = self._execute(job, log, core)
            with self.lock:
                record = finished(self.part, size=self.size, out=self.out).get(job) if code == 0 else None
                if record is None:
                    self.failed.append(job)
                else:
                    self.done[job] = record
                self._say(job, record, time.perf_counter() - start, log)
                self.lock.notify_all()

    def _execute(self, job: Job, log: Path, core: int) -> int:
        command = [
            sys.executable,
            "-m",
            PARTS[self.part].module,
            *overrides(self.part, job, size=self.size, out=self.out),
        ]
        environment = {**os.environ, "NPROC": "1", "OMP_NUM_THREADS": "1"}
        with log.open("wb") as file:
            process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=file, stderr=subprocess.STDOUT)
            if hasattr(os, "sched_setaffinity"):
                os.sched_setaffinity(process.pid, {core})
            with self.lock:
                self.running[job] = process
                if self.stopped:
                    process.terminate()
            code = process.wait()
            with self.lock:
                del self.running[job]
        return code

    def _say(self, job: Job, record: dict[str, Any] | None, seconds: float, log: Path) -> None:
        if self.stopped:
            return
        left = minutes_left(self.part, self.done, self.size) / len(self.cores)
        told = f"validation {record['metrics']['validation_overall']:.3f}" if record else f"failed, see {log}"
        print(f"{self.part}: job {len(self.done) + len(self.failed)} of {count(self.part)}, {left:.0f} min left: "
              f"{job.label}, {told} ({seconds:.0f} s)", flush=True)  # fmt: skip


def listing(parts: list[str], *, size: str, out: Path, processes: int) -> str:
    """Jobs and cost of parts, nothing run."""
    lines = [f"{'part':18}{'jobs':>6}{'done':>6}{'hours left':>12}   of {processes} processes, at size={size}"]
    total = 0.0
    for part in parts:
        done = finished(part, size=size, out=out)
        hours = minutes_left(part, done, size) / 60 / processes
        total += hours
        lines.append(f"{part:18}{count(part):6}{len(done):6}{hours:12.1f}")
    return "\n".join([*lines, f"{'all':18}{'':12}{total:12.1f}"])


def usable_cores() -> list[int]:
    """Numbers of the cores that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def main() -> None:
    """Command line; exit code 2 where a job failed."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.study", description="Run what is missing of the study."
    )
    parser.add_argument("--part", nargs="+", choices=tuple(PARTS), default=list(PARTS), metavar="PART",
                        help=f"of {', '.join(PARTS)}; all in this order by default")  # fmt: skip
    parser.add_argument("--size", default="quick", choices=("smoke", "quick"))
    parser.add_argument("--out", type=Path, default=ROOT / "runs")
    parser.add_argument("--processes", type=int, default=2, help="pinned to a core each")
    parser.add_argument("--dry", action="store_true", help="list jobs and their cost, run nothing")
    options = parser.parse_args()
    cores = usable_cores()
    if not 1 <= options.processes <= len(cores):
        parser.error(f"--processes: expected 1 to {len(cores)}, the usable cores, got {options.processes}")
    out = options.out.resolve()
    if options.dry:
        print(listing(options.part, size=options.size, out=out, processes=options.processes))
        return
    whole = True
    try:
        for part in options.part:
            whole &= Runner(part, size=options.size, out=out, cores=cores[: options.processes]).run()
    except KeyboardInterrupt:
        print("\nInterrupted. The same command goes on from here.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    sys.exit(0 if whole else 2)


if __name__ == "__main__":
    main()
