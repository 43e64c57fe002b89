"""Figures of networks: accuracy and loss against training progress, and which sizes are taken for which."""

import numpy as np

from cablejax.report import line_styles
from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.analysis.statistics import fluctuation
from experiments.display.drawing import Drawing, new_figure
from experiments.display.optimizers.figures import mark_paper

NOTE_SHARE = 0.5  # height of the note under the loss curves, as a share of theirs


def accuracy_curves(found: dict[str, Results]) -> Drawing:
    """Figures 5-8: overall and class-average accuracy on validation against training progress."""
    figure = _curves(found, ("validation_overall", "validation_class_average"))
    panels = zip(figure.axes, ("(a) accuracy, eq. (20)", "(b) class average, eq. (21)"), strict=True)
    for ax, label in panels:
        ax.set_title(label, loc="left", fontsize=10)
        ax.set_ylim(0, 1.05)
        mark_paper(ax, paper.ACCURACY_AFTER, f"paper, ADGCNN {paper.ACCURACY_AFTER}")
    figure.axes[0].set_ylabel("accuracy on validation clouds")
    return Drawing(
        "fig5_8_accuracy",
        figure,
        "Validation accuracies of the networks against training progress.",
        f"Figures 5-8: accuracy against training progress on clouds kept for validation; {_bands(found)}. The two accuracies are "
        "close, since every size has as many clouds. The paper shows such curves without numbers.",
    )


def loss_curves(found: dict[str, Results]) -> Drawing:
    """Figures 9-12: training and validation loss against training progress, with their fluctuation."""
    metrics = ("train_loss", "validation_loss")
    figure = _curves(found, metrics)
    for ax, metric, label in zip(figure.axes, metrics, ("(a) training", "(b) validation"), strict=True):
        ax.set_title(label, loc="left", fontsize=10)
        plain_log_axis(ax)
        rough = [f"{NAMES[r.config('model.name')]} {_roughness(r, metric):.3f}" for r in found.values()]
        ax.annotate("fluctuation (nats)\n" + "\n".join(rough), (0.02, 0.02), xycoords="axes fraction", fontsize=8)
    figure.axes[0].set_ylabel("loss, cross entropy (nats)")
    return Drawing(
        "fig9_12_loss",
        figure,
        "Training and validation loss of the networks against training progress, on a logarithmic axis.",
        f"Figures 9-12: loss of the same runs; {_bands(found)}. Fluctuation: root mean square of the loss about its mean over "
        "three epochs, over the second half of the run. A loss that has not begun to fall fluctuates little, too.",
    )


def plain_log_axis(ax) -> None:
    """A logarithmic axis with ticks in plain numbers, and room below the curves for a note."""
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    low *= (low / high) ** NOTE_SHARE
    ticks = [digit * 10.0**power for power in range(-6, 3) for digit in (1, 2, 5)]
    shown = [tick for tick in ticks if low <= tick <= high]
    ax.set_yticks(shown, [f"{tick:g}" for tick in shown])
    ax.minorticks_off()
    ax.set_ylim(low, high)


def _roughness(results: Results, metric: str) -> float:
    return float(np.mean([fluctuation([epoch[metric] for epoch in row["history"]]) for row in results.rows()]))


def _bands(found: dict[str, Results]) -> str:
    several = any(len(results.rows()) > 1 for results in found.values())
    return "bands run from the lowest to the highest seed" if several else "one seed each"


def _curves(found: dict[str, Results], metrics: tuple[str, str]):
    """Two panels, one metric each, a curve for each network."""
    figure = new_figure(6.6, 3.6)
    axes = figure.subplots(1, 2)
    for style, results in zip(line_styles(), found.values(), strict=False):
        for ax, metric in zip(axes, metrics, strict=True):
            curves = np.array([[epoch[metric] for epoch in row["history"]] for row in results.rows()])
            progress = 100 * np.arange(1, curves.shape[1] + 1) / curves.shape[1]
            ax.plot(progress, curves.mean(axis=0), label=NAMES[results.config("model.name")], **style)
            if len(curves) > 1:
                ax.fill_between(
                    progress, curves.min(axis=0), curves.max(axis=0), color=style["color"], alpha=0.15, lw=0
                )
            ax.set_xlabel("training progress (% of epochs)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def confusions(found: dict[str, Results]) -> Drawing:
    """Confusion matrices on the test split, summed over seeds, as shares of the true size."""
    figure = new_figure(6.6, 0.9 + 2.6 * ((len(found) + 1) // 2))
    axes = figure.subplots((len(found) + 1) // 2, 2, squeeze=False).ravel()
    for ax in axes[len(found) :]:
        ax.set_axis_off()
    for ax, results in zip(axes, found.values(), strict=False):
        rows = results.rows()
        counts = np.sum([row["test_confusion"] for row in rows], axis=0)
        ax.imshow(counts / counts.sum(axis=1, keepdims=True), cmap="Greys", vmin=0, vmax=1)
        labels = rows[0]["labels_mm2"]
        ax.set_xticks(range(len(labels)), labels, rotation=90 if len(labels) > 8 else 0)
        ax.set_yticks(range(len(labels)), labels)
        ax.set_title(NAMES[results.config("model.name")], loc="left", fontsize=10)
        ax.set_xlabel("predicted (mm²)")
        ax.set_ylabel("true (mm²)")
        ax.grid(visible=False)
    figure.colorbar(axes[0].images[0], ax=list(axes), label="share of the true size")
    return Drawing(
        "confusions",
        figure,
        "Confusion matrices of the networks on the test split.",
        "Which nominal cross-section is taken for which, on the test split, all seeds together. Neighbouring sizes differ by "
        "1.2 to 3.3 mm in diameter.",
    )


def robustness(results: Results) -> Drawing:
    """Accuracy of the network and of a cylinder fit against noise, density, the size of a hole and the arc seen."""
    names = {
        "noise_mm": "noise added (mm)",
        "kept": "share of points kept",
        "hole_mm": "radius of a hole (mm)",
        "arc_deg": "arc seen (degrees)",
    }
    figure = new_figure(6.6, 4.8)
    axes = figure.subplots(2, 2, sharey=True).ravel()
    for ax, (kind, label) in zip(axes, names.items(), strict=True):
        rows = [[c for c in row["conditions"] if c["kind"] == kind] for row in results.rows()]
        levels = [c["level"] for c in rows[0]]
        for style, who, name in zip(line_styles(), ("network", "fit"), ("ADGCNN", "cylinder fit"), strict=False):
            accuracy = np.array([[c[who] for c in row] for row in rows])
            ax.plot(levels, accuracy.mean(axis=0), marker="o", ms=4, label=name, **style)
            if len(accuracy) > 1:
                low, high = accuracy.min(axis=0), accuracy.max(axis=0)
                ax.fill_between(levels, low, high, color=style["color"], alpha=0.15, lw=0)
        ax.set_xlabel(label)
        ax.set_ylim(0, 1.05)
        if kind in ("kept", "arc_deg"):
            ax.invert_xaxis()
    for ax in axes[::2]:
        ax.set_ylabel("test accuracy, eq. (20)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return Drawing(
        "robustness",
        figure,
        "Test accuracy against added noise, share of points kept, radius of a hole, and arc seen.",
        "ADGCNN trained on standard clouds, tested on clouds that get worse to the right, beside a cylinder fit to them"
        + ("; bands run from the lowest to the highest seed." if len(results.seeds) > 1 else ", one seed."),
    )
