"""The shell around every experiment: Hydra in, one clear line out."""

import os
import re
import sys
from collections.abc import Callable
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from cablejax.io import PointFileError
from cablejax.types import StatusError
from experiments import ROOT, schema
from experiments.runs import Task, execute

USAGE_ERROR = 2
INTERRUPTED = 130


def to_config(composed: DictConfig) -> schema.Config:
    """Turn a composed configuration into its dataclasses, which check their values; no DictConfig goes further.

    Raises:
        ValueError: Naming the key, what was expected and what came.
    """
    config = OmegaConf.to_object(composed)
    assert isinstance(config, schema.Config)
    return config


def one_line(error: BaseException) -> str:
    """A configuration error in one line, without Hydra's search path and the schema's own options."""
    text = str(error).split("Config search path")[0]
    cause = error.__cause__
    if cause is not None and str(cause).split("\n")[0] not in text:
        text += ". " + str(cause).split("\n")[0]
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    kept = [line for line in lines if not line.startswith(("object_type", "reference_type", "full_key"))]
    return re.sub(r"\bschema_\w+ ", "", " ".join(kept))


def main(task: Task, *, experiment: str, headline: Callable[[dict[str, Any]], str]) -> None:
    """Run a task as a Hydra application; `-m` sweeps, and what is finished already is not run again.

    A job that fails on its configuration or its file is named and does not take the others of its sweep along; the exit
    code then tells.

    Args:
        task: Takes the configuration and the run's folder, returns metrics.
        experiment: File under conf/experiment/ that holds unless the command line names another.
        headline: What to say of a run's metrics in one line.
    """
    # Hydra then raises instead of printing several lines and leaving; the errors are worded below.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    schema.register()
    if not any(argument.startswith("experiment=") for argument in sys.argv[1:]):
        sys.argv.append(f"experiment={experiment}")

    failed: list[str] = []
    home = os.getpid()

    def job(composed: DictConfig) -> None:
        label = ",".join(o for o in HydraConfig.get().overrides.task if not o.startswith(("experiment=", "out=")))
        try:
            config = to_config(composed)
            record, there_already = execute(task, config, label=label)
        except (ValueError, PointFileError, StatusError) as error:
            if (
                os.getpid() != home
            ):  # another process's list would be lost: there Hydra's launcher carries the error back
                raise
            failed.append(label)
            print(f"error: {one_line(error)}" + (f" [{label}]" if label else ""), file=sys.stderr, flush=True)
            return
        state = "done before" if there_already else f"{record['seconds']:.1f} s"
        print(f"{config.name} [{label}] {headline(record['metrics'])} ({state})", flush=True)

    try:
        hydra.main(config_path=str(ROOT / "conf"), config_name="config", version_base="1.3")(job)()
    except (HydraException, OmegaConfBaseException, ValueError, PointFileError, StatusError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except KeyboardInterrupt:
        print("\nInterrupted. The same command goes on from here.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    if failed:
        sys.exit(USAGE_ERROR)
