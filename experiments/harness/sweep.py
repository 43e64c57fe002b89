"""What became of the jobs of a sweep, whichever process they ran in, and the summary at its end.

Every job leaves a small file in the sweep's folder; a Hydra callback clears them when a sweep starts and prints them as
one table when it ends.
"""

import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from cablejax.io import read_json, write_json

JOBS = "jobs"
DONE, DONE_BEFORE, FAILED = "done", "done before", "failed"
WIDEST = 90  # columns of a job's label, so that a line fits a terminal


@dataclass(frozen=True)
class Outcome:
    """One job of a sweep.

    Attributes:
        label: The overrides that set it apart.
        state: "done", "done before" or "failed".
        text: What its metrics say in one line, or its error.
        seconds: Running time, of the earlier run where it was done before.
    """

    label: str
    state: str
    text: str
    seconds: float


def in_sweep() -> bool:
    """Whether the running job is one of a sweep."""
    return HydraConfig.get().mode == RunMode.MULTIRUN


def keep(outcome: Outcome) -> None:
    """Leave a job's outcome where the sweep's summary finds it."""
    hydra = HydraConfig.get()
    folder = Path(hydra.sweep.dir) / JOBS
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / f"{hydra.job.num:05d}.json", asdict(outcome))


def outcomes(sweep_dir: Path) -> list[Outcome]:
    """What the jobs of a sweep left, in their order."""
    return [Outcome(**read_json(path)) for path in sorted((sweep_dir / JOBS).glob("*.json"))]


def summary(jobs: list[Outcome]) -> str:
    """The outcomes as one table: counts, then a line for each job.

    Example:
        >>> print(summary([Outcome("k=5", DONE, "F1 0.98", 1.25), Outcome("k=0", FAILED, "k: expected 1", 0.0)]))
        2 jobs: 1 done, 1 failed
          done         k=5      1.2 s  F1 0.98
          failed       k=0      0.0 s  k: expected 1
    """
    counts = {state: sum(job.state == state for job in jobs) for state in (DONE, DONE_BEFORE, FAILED)}
    told = ", ".join(f"{n} {state}" for state, n in counts.items() if n)
    width = min(WIDEST, max(len(job.label) for job in jobs))
    lines = [f"  {job.state:11}  {job.label:{width}}  {job.seconds:7.1f} s  {job.text}" for job in jobs]
    return "\n".join([f"{len(jobs)} job{'s' if len(jobs) > 1 else ''}: {told}", *lines])


class Summary(Callback):
    """Hydra's hook around a sweep; named in conf/config.yaml.

    Attributes:
        finished: Outcomes of the last sweep that ended in this process.
    """

    finished: tuple[Outcome, ...] = ()

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        Summary.finished = ()
        shutil.rmtree(Path(config.hydra.sweep.dir) / JOBS, ignore_errors=True)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        Summary.finished = tuple(outcomes(Path(config.hydra.sweep.dir)))
        if len(Summary.finished) > 1:
            print("\n" + summary(list(Summary.finished)), flush=True)
