"""Run a sample of the committed results again and compare: does this code on this machine still give those numbers?

    python -m experiments.verify [NAME ...]
    python -m experiments.verify --age

Of the study, `python -m experiments.verify study` replays the first epoch of one run a part where its sources have changed,
and accepts them for all runs where it agrees.

Timings are not compared. Matrix products and sums differ in their last bits between processors, numbers of threads and
versions of jax, so every experiment states a tolerance; training amplifies such bits, so its accuracies get a wide one.
The bend radius of a straight cable is the inverse of next to nothing: it is compared as what it says of the axis, by how
much it leaves the straight line over the cable's length, and within that number's own interval.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cablejax.io import read_json
from cablejax.jax_sums import check_sums
from experiments import ROOT, diameter, table1_filtering, table2_3_deviation, train
from experiments.analysis.results import Results
from experiments.collect import flatten
from experiments.harness import schema
from experiments.harness.runs import Task
from experiments.harness.sources import Sources, at_revision, present
from experiments.material.replay import verify_part
from experiments.material.study_plan import PARTS

SAGITTA, SAGITTA_DOUBT = "bend_sagitta_mm", "bend_sagitta_doubt_mm"
STUDY = "study"
UNTOLD = (SAGITTA_DOUBT, "seconds", "history", "view", "test_confusion", "epoch", "loss", "counts")


@dataclass(frozen=True)
class Sample:
    """One run of a results file to be repeated.

    Attributes:
        task: What runs it.
        cell: Which of the file's runs, by the values of its swept keys; its lowest seed is taken.
        relative: Largest difference allowed, as a share of the number.
        absolute: Or this, in the number's unit, whichever is larger.
    """

    task: Task
    cell: dict[str, Any]
    relative: float
    absolute: float


SAMPLES: dict[str, Sample] = {
    "table1_filtering": Sample(
        table1_filtering.run, {"filter.name": "statistical", "noise.kind": "compound"}, 1e-3, 1e-3
    ),
    "table1_outliers": Sample(
        table1_filtering.run, {"filter.name": "median", "scan.outlier_fraction": 0.2}, 1e-3, 1e-3
    ),
    "table1_noise": Sample(
        table1_filtering.run, {"filter.name": "adaptive", "noise.kind": "random", "noise.snr_db": 40.0}, 1e-3, 1e-3
    ),
    "table2_3_deviation": Sample(table2_3_deviation.run, {"filter.order": 2, "noise.snr_db": 60.0}, 1e-2, 1e-3),
    "diameter": Sample(diameter.run, {"scan.preset": "line-laser"}, 1e-3, 5e-3),
    "fig13_optimizers": Sample(train.run, {"optimizer.name": "adadelta"}, 0.0, 0.1),
}


def differences(committed: dict[str, Any], again: dict[str, Any], sample: Sample) -> list[str]:
    """Numbers that differ by more than the sample allows, one line each; timings and histories are passed over."""
    old, new = flatten(with_sagitta(committed)), flatten(with_sagitta(again))
    told = []
    for key, value in old.items():
        if any(word in key for word in UNTOLD) or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        doubt = old.get(key.replace(SAGITTA, SAGITTA_DOUBT), 0.0) if key.endswith(SAGITTA) else 0.0
        allowed = max(sample.absolute, sample.relative * abs(value), doubt)
        if not abs(new.get(key, float("nan")) - value) <= allowed:
            told.append(f"{key}: committed {value:.6g}, now {new.get(key)}, allowed {allowed:.2g}")
    return told


def with_sagitta(metrics: dict[str, Any]) -> dict[str, Any]:
    """Bend radii, wherever they stand, as sagittas over the length, and half the width of their intervals; 0 for straight.

    Example:
        >>> bent = {"bend_radius_mm": 1e4, "bend_interval_mm": [8e3, 2e4], "length_mm": 400.0}
        >>> with_sagitta({"raw": bent})["raw"]
        {'length_mm': 400.0, 'bend_sagitta_mm': 2.0, 'bend_sagitta_doubt_mm': 0.75}
    """
    found: dict[str, Any] = {
        key: with_sagitta(value) if isinstance(value, dict) else value for key, value in metrics.items()
    }
    if "bend_radius_mm" in found:
        radius, ends, square = found.pop("bend_radius_mm"), found.pop("bend_interval_mm"), found["length_mm"] ** 2
        found[SAGITTA] = 0.0 if radius is None else square / (8 * radius)
        found[SAGITTA_DOUBT] = 0.0 if ends is None else abs(square / (8 * ends[0]) - square / (8 * ends[1])) / 2
    return found


def verify(results: Results, sample: Sample) -> list[str]:
    """Repeat one run of a results file and name what differs.

    Raises:
        ValueError: If the file holds no run of the sample's cell.
    """
    fixed = results.shared
    rows = [
        row
        for row in results.runs
        if all(row["cell"].get(key, fixed.get(key)) == value for key, value in sample.cell.items())
    ]
    if not rows:
        raise ValueError(f"{results.experiment}: expected a run with {sample.cell}, found none")
    row = min(rows, key=lambda r: r["seed"])
    with tempfile.TemporaryDirectory() as folder:
        config = schema.from_flat({**fixed, **row["cell"], "seed": row["seed"], "out": folder})
        return differences(row["metrics"], sample.task(config, Path(folder)), sample)


def age(folder: Path) -> list[str]:
    """Of every results file how many of the sources that it depends on have changed since the commit that made it."""
    told = []
    for path in sorted(folder.glob("*.json")):
        found = read_json(path)
        name, revision = found.get("experiment", path.stem), found.get("code_revision", "").split("+")[0]
        own = SAMPLES[name].task.__module__ if name in SAMPLES else f"experiments.{name}"
        module = own if (ROOT / f"{own.replace('.', '/')}.py").is_file() else "experiments.train"
        try:
            then, now = Sources(at_revision(revision)).digests(module), present(module)
        except ValueError as error:
            told.append(f"{path.stem}: {error}")
            continue
        changed = sum(then.get(each) != digest for each, digest in now.items())
        told.append(f"{path.stem}: made at {revision[:8]}; of its {len(now)} sources {changed} have changed since")
    return told


def main(say: Callable[[str], None] = print) -> None:
    """Verify some or all of the samples; exit code 1 where a number differs."""
    parser = argparse.ArgumentParser(prog="python -m experiments.verify", description="Repeat a sample of the results.")
    known = (*SAMPLES, STUDY)
    parser.add_argument("name", nargs="*", help=f"of {', '.join(known)}; all by default")
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    parser.add_argument("--age", action="store_true", help="say what has changed since each file was made; run nothing")
    options = parser.parse_args()
    if options.age:
        say("\n".join(age(options.results)))
        return
    unknown = set(options.name) - set(known)
    if unknown:
        parser.error(f"name: expected one of {', '.join(known)}, got {', '.join(sorted(unknown))}")
    check_sums()
    bad = False
    for name in options.name or known:
        if name == STUDY:
            for part in PARTS:
                bad |= not verify_part(part, options.results / STUDY, say)
            continue
        results = Results.read(options.results, name)
        if results is None:
            say(f"{name}: no results file")
            continue
        told = verify(results, SAMPLES[name])
        bad |= bool(told)
        say(f"{name}: " + ("\n  ".join(["differs", *told]) if told else "the same within its tolerance"))
    sys.exit(bad)


if __name__ == "__main__":
    main()
