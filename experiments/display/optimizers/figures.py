"""Figures of optimizers: Figure 13, and accuracy against the learning rate."""

import numpy as np

from cablejax.report import line_styles
from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.display.drawing import Drawing, new_figure
from experiments.harness.tuning import best_accuracies


def optimizer_curves(results: Results) -> Drawing:
    """Figure 13: loss and accuracy under each optimizer."""
    figure = new_figure(6.6, 3.6)
    left, right = figure.subplots(1, 2)
    for style, name in zip(line_styles(), results.values("optimizer.name"), strict=False):
        rows = results.rows(optimizer__name=name)
        for ax, metric in ((left, "train_loss"), (right, "validation_overall")):
            curves = np.array([[epoch[metric] for epoch in row["history"]] for row in rows])
            progress = 100 * np.arange(1, curves.shape[1] + 1) / curves.shape[1]
            ax.plot(progress, curves.mean(axis=0), label=NAMES[name], **style)
            if len(curves) > 1:
                ax.fill_between(
                    progress, curves.min(axis=0), curves.max(axis=0), color=style["color"], alpha=0.15, lw=0
                )
    mark_paper(right, paper.ACCURACY_AFTER, f"paper, Adadelta {paper.ACCURACY_AFTER}")
    left.set_title("(a) training loss (nats)", loc="left", fontsize=10)
    right.set_title("(b) validation accuracy, eq. (20)", loc="left", fontsize=10)
    right.set_ylim(0, 1.05)
    for ax in (left, right):
        ax.set_xlabel("training progress (% of epochs)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return Drawing(
        "fig13_optimizers",
        figure,
        "Training loss and validation accuracy against training progress under each optimizer.",
        "Figure 13: the same network, data and seed under five optimizers, each at one stated learning rate"
        + ("." if len(results.seeds) == 1 else "; bands run from the lowest to the highest seed."),
    )


def mark_paper(ax, value: float, text: str) -> None:
    """A thin line at a value of the paper, with its name."""
    ax.axhline(value, color="0.4", lw=0.8, ls="-")
    ax.annotate(text, (0.02, value), xycoords=("axes fraction", "data"), xytext=(0, 3), textcoords="offset points",
                fontsize=8, color="0.3")  # fmt: skip


def sensitivity(results: Results) -> Drawing:
    """Validation accuracy against the learning rate, a curve for each optimizer."""
    figure = new_figure(6.6, 3.6)
    ax = figure.subplots()
    for style, (name, rates) in zip(line_styles(), best_accuracies(results.runs).items(), strict=False):
        ax.plot(list(rates), list(rates.values()), marker="o", ms=3.5, label=NAMES[name], **style)
    ax.set_xscale("log")
    ax.set_xlabel("learning rate")
    ax.set_ylabel("best validation accuracy, eq. (20)")
    ax.set_ylim(0, 1.05)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return Drawing(
        "optimizer_sensitivity",
        figure,
        "Best validation accuracy against the learning rate for seven optimizers, on a logarithmic axis.",
        "How much each optimizer depends on its learning rate: a wide plateau forgives a guess. Each point is one training run.",
    )


def study_bars(results: Results) -> Drawing:
    """Test accuracy of every optimizer, tuned and at Keras' default."""
    figure = new_figure(6.6, 3.4)
    ax = figure.subplots()
    names = sorted(
        results.values("optimizer.name"),
        key=lambda n: results.mean("test_overall", optimizer__name=n, rates="tuned").mean,
    )
    for rates, marker, color, shift in (("tuned", "o", "#0072B2", 0.12), ("keras", "s", "#E69F00", -0.12)):
        there = [i for i, name in enumerate(names) if results.rows(optimizer__name=name, rates=rates)]
        values = [results.mean("test_overall", optimizer__name=names[i], rates=rates) for i in there]
        spread = [0.0 if np.isnan(value.half_width) else value.half_width for value in values]
        label = "tuned rate" if rates == "tuned" else "Keras' default rate"
        ax.errorbar([value.mean for value in values], np.array(there) + shift, xerr=spread, fmt=marker, ms=5,
                    color=color, capsize=3, label=label, ls="none")  # fmt: skip
    ax.set_yticks(range(len(names)), [NAMES[name] for name in names])
    ax.set_xlabel("test accuracy, eq. (20), with 95 % interval over seeds")
    ax.set_xlim(0, 1.02)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return Drawing(
        "optimizer_study",
        figure,
        "Test accuracy of seven optimizers at their tuned learning rate and at Keras' default.",
        "What choosing the optimizer brings, and what choosing its learning rate brings.",
    )
