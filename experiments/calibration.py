"""How right adgcnn_fit is where it is sure, before and after one temperature that validation clouds choose.

    python -m experiments.train -m experiment=hard_adgcnn_fit
    python -m experiments.calibration [--runs runs] [--out results]

Of every finished run the temperature is fitted on clouds of the validation stream, more of them than training looked at, and
then judged once on the run's test clouds, and on new ones, more and of other seeds, for the test clouds called with 90 %
certainty are few. Kept in `<out>/calibration.json`; `experiments.publish` stores it with the weights.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from flax import nnx
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar

from cablejax.io import provenance, write_json
from cablejax.simulate import Split
from cablejax.train.metrics import predict
from experiments import ROOT
from experiments.analysis.inference import wilson
from experiments.collect import CollectError, flatten
from experiments.harness.revision import code_revision, is_clean
from experiments.harness.schema import Config
from experiments.material.training import held_out
from experiments.rejection import TRAINED, reliability, trained

PER_CLASS = 128  # validation clouds of each size: one temperature wants more than the choice of an epoch
BATCH = 32
SPLITS: tuple[str, ...] = ("validation", "test", "new")


def logits_of(network: nnx.Module, split: Split) -> Float[np.ndarray, "clouds classes"]:
    """What a network says of every cloud."""
    graphdef, state = nnx.split(network)
    return np.asarray(predict(graphdef, state, split, batch_size=BATCH)[0])


def temperature_of(logits: Float[np.ndarray, "clouds classes"], label: Int[np.ndarray, " clouds"]) -> float:
    """The temperature that makes the labels likeliest (Guo et al. 2017, section 4.2), between 1/5 and 5."""

    def surprise(log_temperature: float) -> float:
        scaled = logits / np.exp(log_temperature)
        top = scaled.max(axis=1, keepdims=True)
        log_sum = top[:, 0] + np.log(np.exp(scaled - top).sum(axis=1))
        return float(np.mean(log_sum - scaled[np.arange(len(label)), label]))

    found = minimize_scalar(surprise, bounds=(-np.log(5.0), np.log(5.0)), method="bounded")
    return float(np.exp(found.x))


def calibration_clouds(cfg: Config) -> Split:
    """`PER_CLASS` clouds of each size out of the validation stream."""
    return held_out(replace(cfg, dataset=replace(cfg.dataset, validation_per_class=PER_CLASS)), "validation")


def new_clouds(cfg: Config) -> Split:
    """`PER_CLASS` test clouds of each size from another seed of the simulator."""
    return held_out(
        replace(cfg, dataset=replace(cfg.dataset, seed=cfg.dataset.seed + 1, test_per_class=PER_CLASS)), "test"
    )


def judged(network: nnx.Module, splits: dict[str, Split]) -> dict[str, Any]:
    """Temperature of a network by the split "validation", and its reliability before and after on all splits."""
    said = {name: logits_of(network, split) for name, split in splits.items()}
    label = {name: np.asarray(split.label) for name, split in splits.items()}
    temperature = temperature_of(said["validation"], label["validation"])
    return {
        "temperature": temperature,
        **{
            f"{name}_{when}": reliability(logits / t, label[name])
            for name, logits in said.items()
            for when, t in (("before", 1.0), ("after", temperature))
        },
    }


def together(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of the clouds that all seeds together call with 90 % certainty, the share called rightly, with its 95 % interval."""
    found = {}
    for key in (f"{name}_{when}" for name in SPLITS for when in ("before", "after")):
        called, right = (sum(row[key][name] for row in rows) for name in ("called_90", "called_90_right"))
        share = wilson(right, called)
        found[key] = {"called": called, "right": right, "share": share.value, "interval_95": [share.low, share.high]}
    return found


def run(runs: Path, out: Path, *, size: str) -> dict[str, Any]:
    """Calibrate every finished run and write `<out>/calibration.json`.

    Raises:
        CollectError: If there is no run, runs come from several revisions, or code was not committed.
    """
    networks = trained(runs / TRAINED / size)
    first, _, record = networks[0]
    for revision in (record["code_revision"], code_revision()):
        if not is_clean(revision):
            raise CollectError(f"{TRAINED}: made by uncommitted code ({revision}); commit and run again")
    clouds = (calibration_clouds(first), held_out(first, "test"), new_clouds(first))
    splits, rows = dict(zip(SPLITS, clouds, strict=True)), []
    for cfg, network, _ in networks:
        rows.append({"seed": cfg.seed, **judged(network, splits)})
        print(f"seed {cfg.seed}: temperature {rows[-1]['temperature']:.3f}", file=sys.stderr, flush=True)
    result = {
        "experiment": "calibration",
        "size": size,
        "seeds": [row["seed"] for row in rows],
        "code_revision": code_revision(),
        "trained_by": record["code_revision"],
        "provenance": {k: v for k, v in provenance(seeds=[]).items() if k not in ("seeds", "git")},
        "config": {k: v for k, v in flatten(record["config"]).items() if k != "seed"},
        "clouds": {name: len(split.label) for name, split in splits.items()},
        "together": together(rows),
        "runs": rows,
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "calibration.json", result)
    return result


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.calibration", description="Calibrate the runs of adgcnn_fit."
    )
    parser.add_argument("--size", default="quick", choices=("smoke", "quick", "paper"))
    parser.add_argument("--runs", type=Path, default=ROOT / "runs")
    parser.add_argument("--out", type=Path, default=ROOT / "results")
    options = parser.parse_args()
    try:
        found = run(options.runs, options.out, size=options.size)
    except CollectError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    for name, row in found["together"].items():
        low, high = row["interval_95"]
        told = f"{name}: of {row['called']} clouds called with 85 to 95 % certainty {row['right']} are right"
        print(f"{told}, {row['share']:.3f} [{low:.3f}, {high:.3f}]")


if __name__ == "__main__":
    main()
