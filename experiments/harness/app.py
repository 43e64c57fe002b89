"""The shell around every experiment: Hydra in, one clear line out."""

import os
import re
import sys
import traceback
from collections.abc import Callable
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from cablejax.io import PointFileError
from cablejax.jax_sums import WrongSumsError, check_sums
from cablejax.train import TrainingDiverged
from cablejax.types import StatusError
from experiments import ROOT
from experiments.harness import schema, sweep
from experiments.harness.keys import check_keys, without_advice
from experiments.harness.runs import Task, execute

EXPECTED = (
    OmegaConfBaseException,
    ValueError,
    PointFileError,
    StatusError,
    TrainingDiverged,
    WrongSumsError,
    OSError,
)  # a person's doing, worded in one line
UNTOLD = ("experiment=", "launcher=", "sweeper=", "size=", "out=")  # the same in all jobs of a sweep
TUNES = re.compile(r"\+{0,2}(hydra/)?sweeper=(?!basic$)")  # a sweeper that chooses trials by the last ones' outcome
USAGE_ERROR = 2
INTERRUPTED = 130


def to_config(composed: DictConfig) -> schema.Config:
    """Turn a composed configuration into its dataclasses, which check their values; no DictConfig goes further.

    Raises:
        ValueError: Naming the key, what was expected and what came.
    """
    check_keys(composed)
    config = OmegaConf.to_object(composed)
    assert isinstance(config, schema.Config)
    return config


def composed(*overrides: str) -> schema.Config:
    """The configuration that a command line composes to."""
    schema.register()
    with hydra.initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return to_config(hydra.compose("config", overrides=list(overrides)))


def one_line(error: BaseException) -> str:
    """An error in one line: a configuration's without Hydra's search path and advice, the system's with its place."""
    if isinstance(error, OSError) and error.strerror:  # Hydra's own are OSErrors too
        place = "" if error.filename is None else f"{error.filename}: "
        return f"{place}{error.strerror}"
    text = str(error).split("Config search path")[0]
    cause = error.__cause__
    if cause is not None and str(cause).split("\n")[0] not in text:
        text += ". " + str(cause).split("\n")[0]
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    kept = [line for line in lines if not line.startswith(("object_type", "reference_type", "full_key"))]
    return without_advice(re.sub(r"\bschema_\w+ ", "", " ".join(kept)))


def main(
    task: Task,
    *,
    experiment: str,
    headline: Callable[[dict[str, Any]], str],
    objective: Callable[[dict[str, Any]], float] | None = None,
) -> None:
    """Run a task as a Hydra application; `-m` sweeps, and what is finished already is not run again.

    A job of a sweep that fails is named, in the summary too, and does not take the others along; the exit code then tells.

    Args:
        task: Takes the configuration and the run's folder, returns metrics.
        experiment: File under conf/experiment/ that holds unless the command line names another.
        headline: What to say of a run's metrics in one line.
        objective: What a tuning sweeper (`sweeper=optuna`) makes as large as it can.
    """
    # Hydra then raises instead of printing several lines and leaving; the errors are worded below.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    schema.register()
    if not any(argument.startswith("experiment=") for argument in sys.argv[1:]):
        sys.argv.append(f"experiment={experiment}")

    tuning = [argument for argument in sys.argv[1:] if TUNES.match(argument)]
    if objective is None and tuning:
        print(f"error: {tuning[0]}: nothing to tune, for only experiments.train has an objective", file=sys.stderr)
        sys.exit(USAGE_ERROR)

    failed: list[str] = []  # of this process; those of other processes are in the sweep's summary

    def job(composed: DictConfig) -> float | None:
        label = ",".join(o for o in HydraConfig.get().overrides.task if not o.startswith(UNTOLD))
        try:
            metrics, outcome = _run_job(task, composed, label, headline)
        except Exception as error:
            expected = isinstance(error, EXPECTED)
            if not sweep.in_sweep() and not expected:
                raise  # with Hydra's and Python's whole story, for whoever mends it
            if sweep.in_sweep():  # whatever it is, the other jobs go on
                sweep.keep(sweep.Outcome(label, sweep.FAILED, _told(error), 0.0))
            failed.append(label)
            return float("nan")
        if sweep.in_sweep():
            sweep.keep(outcome)
        return None if objective is None else objective(metrics)

    try:
        hydra.main(config_path=str(ROOT / "conf"), config_name="config", version_base="1.3")(job)()
    except (HydraException, *EXPECTED) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except KeyboardInterrupt:
        print("\nInterrupted. The same command goes on from here.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    if failed or any(outcome.state == sweep.FAILED for outcome in sweep.Summary.finished):
        sys.exit(USAGE_ERROR)


def _run_job(task: Task, composed: DictConfig, label: str, headline: Callable[[dict[str, Any]], str]):
    """Run one job and say so; its metrics and its outcome."""
    try:
        check_sums()
        config = to_config(composed)
        record, there_already = execute(task, config, label=label)
    except EXPECTED as error:
        print(f"error: {one_line(error)}" + (f" [{label}]" if label else ""), file=sys.stderr, flush=True)
        raise
    text = headline(record["metrics"])
    state = sweep.DONE_BEFORE if there_already else sweep.DONE
    told = state if there_already else f"{record['seconds']:.1f} s"
    print(f"{config.name} [{label}] {text} ({told})", flush=True)
    return record["metrics"], sweep.Outcome(label, state, text, record["seconds"])


def _told(error: Exception) -> str:
    """A failed job's error in one line; an unexpected one is shown with its traceback, for whoever mends it."""
    if isinstance(error, EXPECTED):
        return one_line(error)
    traceback.print_exception(error)
    return f"{type(error).__name__}: {one_line(error)}"
