"""The short training of `make run`, beside what longer ones, committed in results/, reached."""

from pathlib import Path

import numpy as np

from cablejax.report import line_styles
from experiments import ROOT
from experiments.analysis import paper
from experiments.analysis.inference import wilson
from experiments.analysis.results import Results
from experiments.analysis.study_summary import OWN, arms, summary
from experiments.display.drawing import Drawing, new_figure
from experiments.display.optimizers.figures import mark_paper
from experiments.display.table import Table, schedule


def table(results: Results, committed: Path = ROOT / "results") -> Table:
    """The short training's accuracy, with the fit's on the same clouds and the committed long result."""
    row = results.rows()[0]
    tested = int(np.sum(row["test_confusion"]))
    right = int(np.trace(np.asarray(row["test_confusion"])))
    rows = [
        [f"this run, short: {results.config('training.epochs')} epochs, fresh clouds, no raster stages",
         wilson(right, tested).format(3), "1"],
        ["a cylinder fit on the same clouds, no network", f"{row['baseline_overall']:.3f}", ""],
    ]  # fmt: skip
    rows += _committed(committed)
    rows.append(["the paper, on data that is not published", f"{paper.ACCURACY_AFTER}", ""])
    return Table(
        "Figure 13, a short training: ADGCNN under Adadelta at the paper's rate of 1",
        ["Training", "accuracy [eq. (20)]", "seeds"],
        rows,
        f"Test accuracy at the epoch best on validation, of {tested} clouds of {len(row['labels_mm2'])} sizes with Wilson's 95 % "
        f"interval; {schedule(results)}, size {results.size}. One seed shows that it trains, not that Adadelta is "
        "better than others: for that see docs/study.md. The radius of a fitted cylinder is among the network's input.",
    )


def _committed(folder: Path) -> list[list[str]]:
    """Rows of longer trainings in a results folder."""
    rows = []
    study = Results.read(folder, "study_standard_fit")
    if study is not None and OWN in arms(study):
        own = summary(study, OWN)
        rows.append(
            ["committed: the study, whole network, tuned, interquartile mean", own.accuracy.format(3), str(own.n)]
        )
    long = Results.read(folder, "standard_adgcnn")
    if long is not None:
        rate = long.rows()[0]["learning_rate"]
        told = f"committed: whole network, {long.config('training.epochs')} epochs of fixed clouds, rate {rate:g}"
        accuracy = [each["test_overall"] for each in long.rows()]
        rows.append([told, f"{np.mean(accuracy):.3f} ({min(accuracy):.3f} to {max(accuracy):.3f})", str(len(accuracy))])
    return rows


def curve(results: Results) -> Drawing:
    """Loss and accuracy of the short training."""
    figure = new_figure(6.6, 3.2)
    axes = figure.subplots(1, 2)
    history = results.rows()[0]["history"]
    epochs = np.arange(1, len(history) + 1)
    style = next(iter(line_styles()))
    for ax, metric in zip(axes, ("train_loss", "validation_overall"), strict=True):
        ax.plot(epochs, [each[metric] for each in history], **style)
        ax.set_xlabel("epoch")
    axes[0].set_title("(a) training loss (nats)", loc="left", fontsize=10)
    axes[1].set_title("(b) validation accuracy, eq. (20)", loc="left", fontsize=10)
    axes[1].set_ylim(0, 1.05)
    mark_paper(axes[1], paper.ACCURACY_AFTER, f"paper, Adadelta {paper.ACCURACY_AFTER}")
    return Drawing(
        "fig13_short",
        figure,
        "Training loss and validation accuracy of a short training under Adadelta, against epochs.",
        "Figure 13, a short training: ADGCNN without its raster stages under Adadelta at rate 1, on clouds that are new in every "
        "epoch, one seed.",
    )
