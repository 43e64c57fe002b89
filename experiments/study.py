"""Run what is missing of the study: search, confirm and final runs of every arm, part by part.

    python -m experiments.study [--part standard_nofit ...] [--minutes 110] [--core 1] [--dry]

One process works off job after job, so that a network under an optimizer is compiled once and clouds are simulated once. Each
finished run is a line of results/study/<part>.jsonl, from which the same command goes on, killed at any time, on any day, after
any commit that leaves the sources of the runs alone; `python -m experiments.verify study` replays a sample where they changed.
docs/study.md is the protocol.
"""

import argparse
import importlib
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from cablejax.jax_sums import check_sums
from experiments import ROOT
from experiments.harness import run_log
from experiments.harness.revision import code_revision
from experiments.harness.sources import present
from experiments.material.study_plan import FINAL, PARTS, Job, Records, config_of, count, jobs

LOG = ROOT / "results" / "study"
INTERRUPTED = 130


def sources(part: str) -> dict[str, str]:
    """Digests of what the runs of a part depend on beside their configuration."""
    return present(PARTS[part].module, PARTS[part].unused)


def finished(part: str, *, size: str, log: Path) -> Records:
    """The runs that the present sources and configuration stand for, by job."""
    found: Records = {}
    for line in run_log.current(log, run_log.lines(log / f"{part}.jsonl"), sources(part)):
        job = Job(line["stage"], line["arm"], line["trial"], line["seed"])
        known = job.arm in PARTS[part].arms
        if known and job not in found and line["config"] == run_log.config_digest(config_of(part, job, size=size)):
            found[job] = {**line, "metrics": run_log.expanded(line["metrics"])}
    return found


def execute(part: str, job: Job, *, size: str, log: Path) -> dict[str, Any]:
    """Do a job and write its line."""
    this, cfg = PARTS[part], config_of(part, job, size=size)
    start, busy = time.perf_counter(), time.process_time()
    metrics = importlib.import_module(this.module).measured(cfg)
    line = {
        **job._asdict(),
        "size": size,
        "options": cfg.optimizer.options,
        "seconds": round(time.perf_counter() - start, 1),
        "cpu_seconds": round(time.process_time() - busy, 1),
        "metrics": run_log.compact(metrics, losses=job.stage == FINAL),
        "config": run_log.config_digest(cfg),
        "revision": code_revision()[:12],
        "origin": run_log.register(log, run_log.origin(this.module, this.unused)),
    }
    run_log.append(log / f"{part}.jsonl", line)
    return {**line, "metrics": metrics}


def minutes_left(part: str, done: Records, size: str) -> float:
    """Processor time of what is missing, at the mean of what was done."""
    seconds = [record["cpu_seconds"] for record in done.values()]
    each = float(np.mean(seconds)) / 60 if seconds else PARTS[part].minutes if size == "quick" else 0.2
    return (count(part) - len(done)) * each


def work(part: str, *, size: str, log: Path, until: float = float("inf"), mine: slice = slice(None)) -> bool:
    """Do a part's jobs one by one; whether all of this process's are done.

    Args:
        part: Its name.
        size: smoke or quick.
        log: Folder of the lines.
        until: No job is begun after this time, as `time.monotonic` counts it.
        mine: Of the part's arms, those that this process does.
    """
    arms = list(PARTS[part].arms)[mine]
    failed: list[Job] = []
    while True:
        done = finished(part, size=size, log=log)
        left = [job for job in jobs(part, done) if job.arm in arms and job not in done and job not in failed]
        if not left or time.monotonic() >= until:
            return not left and not failed
        job = left[0]
        try:
            record = execute(part, job, size=size, log=log)
        except (ValueError, RuntimeError, OSError):  # the other jobs go on; the next call tries this one again
            traceback.print_exc()
            failed.append(job)
            print(f"{part}: {job.label}: failed", file=sys.stderr, flush=True)
            continue
        done[job] = record
        left_minutes = minutes_left(part, done, size)
        print(f"{part}: job {len(done)} of {count(part)}, {left_minutes:.0f} min left: {job.label}, validation "
              f"{record['metrics']['validation_overall']:.3f} ({record['seconds']:.0f} s)", flush=True)  # fmt: skip


def listing(parts: list[str], *, size: str, log: Path) -> str:
    """Jobs and cost of parts, nothing run."""
    lines = [f"{'part':18}{'jobs':>6}{'done':>6}{'hours left':>12}   of one process on one core, at size={size}"]
    total = 0.0
    for part in parts:
        done = finished(part, size=size, log=log)
        hours = minutes_left(part, done, size) / 60
        total += hours
        lines.append(f"{part:18}{count(part):6}{len(done):6}{hours:12.1f}")
    return "\n".join([*lines, f"{'all':18}{'':12}{total:12.1f}"])


def usable_cores() -> list[int]:
    """Numbers of the cores that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def pin(core: int) -> None:
    """Keep this process to one core, before jax starts its threads: two such processes do more than one with two threads."""
    os.environ.update(NPROC="1", OMP_NUM_THREADS="1")
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})


def _share(text: str) -> slice:
    try:
        own, all_ = map(int, text.split("/"))
    except ValueError:
        own, all_ = 0, 0
    if not 1 <= own <= all_:
        raise argparse.ArgumentTypeError(f"expected I/N with 1 <= I <= N, such as 1/2, got {text}")
    return slice(own - 1, None, all_)


def main() -> None:
    """Command line; exit code 2 where a job failed."""
    cores = usable_cores()
    parser = argparse.ArgumentParser(
        prog="python -m experiments.study", description="Run what is missing of the study."
    )
    parser.add_argument("--part", nargs="+", choices=tuple(PARTS), default=list(PARTS), metavar="PART",
                        help=f"of {', '.join(PARTS)}; all in this order by default")  # fmt: skip
    parser.add_argument("--size", default="quick", choices=("smoke", "quick"))
    parser.add_argument("--log", type=Path, help="folder of the finished runs; results/study, at size=smoke runs/study")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no job after so many minutes")
    parser.add_argument("--core", type=int, default=cores[-1], help="that this process is pinned to")
    parser.add_argument("--share", type=_share, default=slice(None), metavar="I/N",
                        help="of N processes this is the I-th: each takes every N-th arm")  # fmt: skip
    parser.add_argument("--dry", action="store_true", help="list jobs and their cost, run nothing")
    options = parser.parse_args()
    if options.core not in cores:
        parser.error(f"--core: expected one of {', '.join(map(str, cores))}, the usable cores, got {options.core}")
    log = options.log or (LOG if options.size == "quick" else ROOT / "runs" / "study")
    if options.dry:
        print(listing(options.part, size=options.size, log=log))
        return
    pin(options.core)
    check_sums()
    until, whole = time.monotonic() + 60 * options.minutes, True
    try:
        for part in options.part:
            whole &= work(part, size=options.size, log=log, until=until, mine=options.share)
    except KeyboardInterrupt:
        print("\nInterrupted. The same command goes on from here.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    sys.exit(0 if whole or time.monotonic() >= until else 2)


if __name__ == "__main__":
    main()
