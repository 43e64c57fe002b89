"""Figure 13 with and without transfer: a table and a figure."""

import numpy as np

from cablejax.report import line_styles
from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.analysis.statistics import paired_difference
from experiments.display.drawing import Drawing, new_figure
from experiments.display.optimizers.figures import mark_paper
from experiments.display.table import Table, told

STARTS = {"none": "random weights", "modelnet10": "weights from ModelNet10"}


def table(results: Results) -> Table:
    """Each optimizer's accuracy from random and from transferred weights, and the gain."""
    rows = []
    for name in results.values("optimizer.name"):
        cells = {start: {"optimizer__name": name, "transfer": start} for start in STARTS}
        accuracy = {start: [row["test_overall"] for row in results.rows(**cell)] for start, cell in cells.items()}
        gain, p_value = paired_difference(accuracy["modelnet10"], accuracy["none"])
        early = {start: _early(results, cell) for start, cell in cells.items()}
        rows.append(
            [
                NAMES[name],
                *[results.mean("test_overall", **cell).format(3) for cell in cells.values()],
                gain.format(3),
                "" if np.isnan(p_value) else f"{p_value:.2f}",
                *[f"{value:.3f}" for value in early.values()],
            ]
        )
    rows.sort(key=lambda row: -float(row[1].split(" ")[0]))
    return Table(
        "Figure 13 with transfer: from random weights and from ModelNet10's",
        ["Optimizer", "random", "transferred", "gain", "p", "random, first epoch", "transferred, first epoch"],
        rows,
        "Test accuracy [eq. (20)] at the epoch best on validation, and validation accuracy after one epoch; "
        f"{len(results.config('dataset.sizes_mm2'))} sizes, {results.config('training.epochs')} epochs, {told(results)}. "
        "p: paired t test. Transferred: weights that the same network learnt on ModelNet10's clouds, free to move afterwards.",
    )


def _early(results: Results, cell: dict[str, str]) -> float:
    return float(np.mean([row["history"][0]["validation_overall"] for row in results.rows(**cell)]))


def curves(results: Results) -> Drawing:
    """Loss and accuracy under Adadelta and the best other optimizer, from random and from transferred weights."""
    others = [name for name in results.values("optimizer.name") if name != "adadelta"]
    rival = max(others, key=lambda name: results.mean("validation_overall", optimizer__name=name, transfer="none").mean)
    figure = new_figure(6.6, 3.7)
    axes = figure.subplots(1, 2)
    lines = [(name, start) for name in ("adadelta", rival) for start in STARTS]
    for style, (name, start) in zip(line_styles(), lines, strict=False):
        rows = results.rows(optimizer__name=name, transfer=start)
        for ax, metric in zip(axes, ("train_loss", "validation_overall"), strict=True):
            runs = np.array([[epoch[metric] for epoch in row["history"]] for row in rows])
            progress = 100 * np.arange(1, runs.shape[1] + 1) / runs.shape[1]
            ax.plot(progress, runs.mean(axis=0), label=f"{NAMES[name]}, {STARTS[start]}", **style)
            if len(runs) > 1:
                ax.fill_between(progress, runs.min(axis=0), runs.max(axis=0), color=style["color"], alpha=0.15, lw=0)
    for ax, title in zip(axes, ("(a) training loss (nats)", "(b) validation accuracy, eq. (20)"), strict=True):
        ax.set_title(title, loc="left", fontsize=10)
        ax.set_xlabel("training progress (% of epochs)")
    mark_paper(axes[1], paper.ACCURACY_AFTER, f"paper, Adadelta {paper.ACCURACY_AFTER}")
    axes[1].set_ylim(0, 1.05)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return Drawing(
        "fig13_transfer",
        figure,
        "Training loss and validation accuracy with and without transferred weights, under Adadelta and one other optimizer.",
        f"Figure 13 with transfer: Adadelta and {NAMES[rival]}, the best of the others, from random weights and from weights "
        "trained on ModelNet10's clouds, in which no cable is.",
    )
