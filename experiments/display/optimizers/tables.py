"""Tables of optimizers: Figure 13 in numbers, and the study with equal tuning budgets."""

import math
from typing import Any

from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.analysis.statistics import estimate, paired_difference
from experiments.display.table import Table, schedule, told
from experiments.harness.tuning import best_accuracies

FULL_SET = "sgd"  # one update an epoch, with the gradient of the whole training set
TARGET = 0.7  # validation accuracy whose first epoch the study reports


def optimizers(results: Results) -> Table:
    """Figure 13 in numbers: each optimizer's accuracy and loss."""
    names = sorted(
        results.values("optimizer.name"), key=lambda n: -results.mean("test_overall", optimizer__name=n).mean
    )
    rows = []
    for name in names:
        cell = {"optimizer__name": name}
        histories = [row["history"] for row in results.rows(**cell)]
        rows.append(
            [
                NAMES.get(name, name),
                f"{results.config_of('optimizer.learning_rate', **cell):g}",
                results.mean("test_overall", **cell).format(3),
                results.mean("test_class_average", **cell).format(3),
                f"{estimate([history[0]['train_loss'] for history in histories]).mean:.3f}",
                f"{estimate([history[-1]['train_loss'] for history in histories]).mean:.3f}",
                f"{results.least('train_seconds', **cell):.0f}",
            ]
        )
    classes = len(results.config("dataset.sizes_mm2"))
    return Table(
        "Figure 13: ADGCNN on simulated cables under five optimizers",
        [
            "Optimizer",
            "rate",
            "accuracy [eq. (20)]",
            "class average [eq. (21)]",
            "first loss",
            "last loss",
            "train (s)",
        ],
        rows,
        f"Test accuracy at the epoch best on validation; {classes} sizes, {results.config('dataset.n_points')} points a cloud, "
        f"{results.config('training.epochs')} epochs, {schedule(results)}, {told(results)}. {fitted_beside(results)}"
        f"The paper: {paper.ACCURACY_BEFORE} before, {paper.ACCURACY_AFTER} after Adadelta, on data that is not published. "
        "Seconds are the least of the seeds.",
    )


def fitted_beside(results: Results) -> str:
    """A sentence on what a cylinder fit reaches on the same test clouds; empty where it was not recorded."""
    rows = [row for row in results.rows() if "baseline_overall" in row]
    return f"A cylinder fit and the nearest size: {rows[0]['baseline_overall']:.3f}. " if rows else ""


def search(results: Results) -> Table:
    """What tuning found: each optimizer's best learning rate on validation, and how many rates do nearly as well."""
    rows, at_end = [], []
    for name, rates in best_accuracies(results.runs).items():
        best = max(rates, key=lambda rate: (rates[rate], rate))
        near = [rate for rate, accuracy in rates.items() if accuracy >= 0.9 * rates[best]]
        at_end += [NAMES[name]] if best == max(rates) else []
        rows.append(
            [
                NAMES[name],
                f"{min(rates):.2g} - {max(rates):.2g}",
                str(len(rates)),
                f"{best:g}",
                f"{rates[best]:.3f}",
                f"{min(near):.2g} - {max(near):.2g}",
                f"{len(near)} of {len(rates)}",
            ]
        )
    rows.sort(key=lambda row: -float(row[4]))
    return Table(
        "Tuning: the same number of quasi-random learning rates for every optimizer",
        [
            "Optimizer",
            "rates tried",
            "trials",
            "best rate",
            "validation accuracy",
            "rates within 10 %",
            "trials within 10 %",
        ],
        rows,
        "Log-uniform over four decades, chosen by the best validation accuracy of any epoch; the test split is not touched. "
        f"Within 10 %: rates that reach nine tenths of the best accuracy; {schedule(results)}, {told(results)}."
        + (
            f" Best at the largest rate tried, so that a larger one may be better still: {', '.join(at_end)}."
            if at_end
            else ""
        ),
    )


def study(results: Results) -> Table:
    """Every optimizer at its tuned rate and at Keras' default, over seeds."""
    rows = []
    tuned = {"rates": "tuned"}
    reference = [row["test_overall"] for row in results.rows(optimizer__name="adadelta", **tuned)]
    names = results.values("optimizer.name")
    for name in sorted(names, key=lambda n: -results.mean("test_overall", optimizer__name=n, **tuned).mean):
        cell = {"optimizer__name": name}
        own = results.rows(**cell, **tuned)
        rows.append(
            [
                NAMES[name],
                f"{own[0]['learning_rate']:g}",
                results.mean("test_overall", **cell, **tuned).format(3),
                results.mean("test_class_average", **cell, **tuned).format(3),
                _against(reference, [row["test_overall"] for row in own]) if name != "adadelta" else "",
                _reached(own, 1 if name == FULL_SET else steps_per_epoch(results)),
                *_at_default(results, name),
            ]
        )
    return Table(
        "Seven optimizers, each at its tuned learning rate and at Keras' default",
        [
            "Optimizer",
            "tuned rate",
            "accuracy [eq. (20)]",
            "class average [eq. (21)]",
            "Adadelta is better by",
            f"epochs, steps (s) to {TARGET:g}",
            "Keras' rate",
            "accuracy [eq. (20)]",
        ],
        rows,
        f"Test accuracy at the epoch best on validation; {len(results.config('dataset.sizes_mm2'))} sizes, "
        f"{results.config('dataset.n_points')} points a cloud, {results.config('training.epochs')} epochs, "
        f"{schedule(results)}, {told(results)}. Better by: paired over seeds, with the p-value of a t test. To {TARGET:g}: first "
        "epoch of that validation accuracy, updates and training time until then, mean of the seeds that reach it.",
    )


def _at_default(results: Results, name: str) -> tuple[str, str]:
    """Keras' rate and the accuracy there, empty where it was not run."""
    rows = results.rows(optimizer__name=name, rates="keras")
    if not rows:
        return "", ""
    return f"{rows[0]['learning_rate']:g}", results.mean("test_overall", optimizer__name=name, rates="keras").format(3)


def _against(reference: list[float], other: list[float]) -> str:
    difference, p = paired_difference(reference, other)
    return difference.format(3) if math.isnan(p) else f"{difference.format(3)} (p {p:.2g})"


def steps_per_epoch(results: Results) -> int:
    """Updates in an epoch of the study's mini-batch optimizers; the last, smaller batch is left out."""
    clouds = len(results.config("dataset.sizes_mm2")) * results.config("dataset.train_per_class")
    return clouds // results.config("training.batch_size")


def _reached(rows: list[dict[str, Any]], steps: int) -> str:
    """Epoch, update and training seconds at which the target was first reached."""
    found = []
    for row in rows:
        passed = [epoch for epoch in row["history"] if epoch["validation_overall"] >= TARGET]
        if passed:
            seconds = sum(epoch["seconds"] for epoch in row["history"] if epoch["epoch"] <= passed[0]["epoch"])
            found.append((passed[0]["epoch"], seconds))
    if not found:
        return "not reached"
    epochs, seconds = (sum(each) / len(found) for each in zip(*found, strict=True))
    share = "" if len(found) == len(rows) else f", {len(found)} of {len(rows)} seeds"
    return f"{epochs:.1f}, {epochs * steps:.0f} ({seconds:.0f}){share}"
