"""The figures of README, report and notebooks, made from results files alone.

python -m experiments.figures --results results --out results/figures
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cablejax.io import atomic_write
from cablejax.report import COLORS, figure_style, line_styles, png_bytes, point_views
from experiments import paper
from experiments.results import NAMES, Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass
class Drawing:
    """A figure with what a reader needs beside it."""

    name: str
    figure: "Figure"
    alt: str
    caption: str


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def deviation(results: Results) -> Drawing:
    """Tables 2 and 3: spread and share within tolerance, before and after, ours and the paper's."""
    figure = _figure(6.6, 3.4)
    left, right = figure.subplots(1, 2)
    snrs = results.values("noise.snr_db")
    orders = results.values("filter.order")
    series = [("before", "before", {"filter__order": orders[0]})]
    series += [(f"after, order {order}", "after", {"filter__order": order}) for order in orders]
    for ax, metric, column in ((left, "std_mm", 1), (right, "within_percent", 2)):
        for style, (label, when, cell) in zip(line_styles(), series, strict=False):
            points = [results.mean(f"{when}.{metric}", noise__snr_db=snr, **cell) for snr in snrs]
            spread = [0.0 if np.isnan(p.half_width) else p.half_width for p in points]
            ax.errorbar(snrs, [p.mean for p in points], spread, label=label, marker="o", ms=4, capsize=3, **style)
        for label, table, marker in (("paper, before", paper.TABLE_2, "x"), ("paper, after", paper.TABLE_3, "+")):
            ax.plot(list(table), [row[column] for row in table.values()], marker, color="0.4", label=label, ls="none")
        ax.set_xlabel("added noise, signal-to-noise ratio (dB)")
        ax.set_xticks(snrs)
        ax.set_ylim(bottom=0)
    left.set_ylabel("standard deviation (mm)")
    right.set_ylabel(f"within ±{results.config('tolerance_mm'):g} mm (%)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return Drawing(
        "deviation",
        figure,
        "Standard deviation and share within tolerance against the signal-to-noise ratio, before and after filtering.",
        "Deviation from the true surface before and after the adaptive filter, ours (lines) and the paper's (crosses).",
    )


def removal(results: Results) -> Drawing:
    """Table 1: how well each filter finds the outliers."""
    figure = _figure(6.6, 3.2)
    ax: Axes = figure.subplots()
    noises = results.values("noise.kind")
    names = [name for name in paper.TABLE_1 if name in results.values("filter.name")]
    width = 0.8 / len(names)
    for i, (name, hatch) in enumerate(zip(names, ("", "//", "..", "xx"), strict=False)):
        values = [results.mean("f1", filter__name=name, noise__kind=noise) for noise in noises]
        spread = [0.0 if np.isnan(v.half_width) else v.half_width for v in values]
        at = np.arange(len(noises)) + (i - (len(names) - 1) / 2) * width
        ax.bar(
            at,
            [v.mean for v in values],
            width,
            yerr=spread,
            label=NAMES[name],
            color=COLORS[i],
            hatch=hatch,
            ec="white",
        )
    ax.set_xticks(range(len(noises)), [f"{NAMES[noise]} noise" for noise in noises])
    ax.set_ylim(0, 1.02)
    ax.set_ylabel("F1 of removal (1 is best)")
    ax.grid(visible=False, axis="x")
    figure.legend(loc="outside lower center", ncols=4)
    return Drawing(
        "removal",
        figure,
        "F1 score of outlier removal for four filters and three kinds of noise.",
        "Table 1 against the truth: F1 of removing the simulated outliers. Fewer points left is not better by itself.",
    )


def section(results: Results) -> Drawing:
    """A slice of the scan before and after filtering, on the true circle."""
    view = results.rows(scan__preset=results.values("scan.preset")[-1])[0]["view"]
    radius = view["radius_mm"]
    figure = _figure(6.6, 3.9)
    panels = zip(figure.subplots(1, 2, sharex=True, sharey=True), ("raw", "filtered"), strict=True)
    angle = np.linspace(0, 2 * np.pi, 400)
    for ax, kind in panels:
        points = np.asarray(view["section"][kind])
        ax.plot(radius * np.cos(angle), radius * np.sin(angle), color=COLORS[6], lw=1, ls="-", label="true section")
        ax.plot(points[:, 0], points[:, 1], ".", ms=2, color=COLORS[0], ls="none", label="points", alpha=0.6)
        ax.set_title(f"{kind}, {len(points):,} points of a {view['slice_mm']:g} mm slice", loc="left", fontsize=10)
        ax.set_xlim(-1.35 * radius, 1.35 * radius)
        ax.set_ylim(-1.35 * radius, 1.35 * radius)
        ax.set_aspect("equal")
        ax.set_xlabel("across (mm)")
    figure.axes[0].set_ylabel("across (mm)")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=4)
    return Drawing(
        "section",
        figure,
        "Cross-section of the simulated scan before and after filtering, with the true circle.",
        "A slice of the 53,135-point scan with the paper's floor of 0.385 mm, before and after outlier removal and the "
        "adaptive filter. Parts beyond 1.35 radii are cut off.",
    )


def scan_views(results: Results) -> Drawing:
    """The scan from the side, coloured by deviation."""
    view = results.rows(scan__preset=results.values("scan.preset")[-1])[0]["view"]
    clouds = {
        kind: (np.asarray(view[kind]["xyz_mm"]), np.asarray(view[kind]["deviation_mm"])) for kind in ("raw", "filtered")
    }
    return Drawing(
        "scan",
        point_views(clouds, label="deviation (mm)", limit=3 * view["scale_mm"]),
        "The simulated scan from the side before and after filtering, coloured by deviation from the true surface.",
        "The scan before and after filtering; colour is the signed distance to the true surface.",
    )


def optimizer_curves(results: Results) -> Drawing:
    """Figure 13: loss and accuracy under each optimizer."""
    figure = _figure(6.6, 3.6)
    left, right = figure.subplots(1, 2)
    for style, name in zip(line_styles(), results.values("optimizer.name"), strict=False):
        rows = results.rows(optimizer__name=name)
        for ax, metric in ((left, "train_loss"), (right, "validation_overall")):
            curves = np.array([[epoch[metric] for epoch in row["history"]] for row in rows])
            epochs = np.arange(1, curves.shape[1] + 1)
            ax.plot(epochs, curves.mean(axis=0), label=NAMES[name], **style)
            if len(curves) > 1:
                ax.fill_between(epochs, curves.min(axis=0), curves.max(axis=0), color=style["color"], alpha=0.15, lw=0)
    right.axhline(paper.ACCURACY_AFTER, color="0.4", lw=0.8)
    right.annotate(f"paper, Adadelta {paper.ACCURACY_AFTER}", (0.02, paper.ACCURACY_AFTER), xycoords=("axes fraction", "data"),
                   xytext=(0, 3), textcoords="offset points", fontsize=8, color="0.3")  # fmt: skip
    left.set_ylabel("training loss (nats)")
    right.set_ylabel("validation accuracy, eq 20 (-)")
    right.set_ylim(0, 1.05)
    for ax in (left, right):
        ax.set_xlabel("epoch")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return Drawing(
        "fig13_optimizers",
        figure,
        "Training loss and validation accuracy against the epoch under each optimizer.",
        "Figure 13: the same network, data and seed under five optimizers, each at one stated learning rate"
        + ("." if len(results.seeds) == 1 else "; bands run from the lowest to the highest seed."),
    )


MAKERS: dict[str, tuple[Callable[[Results], Drawing], ...]] = {
    "table1_filtering": (removal,),
    "table2_3_deviation": (deviation,),
    "diameter": (scan_views, section),
    "fig13_optimizers": (optimizer_curves,),
}


def all_figures(folder: Path) -> list[Drawing]:
    """Every figure whose results file is in the folder."""
    drawings = []
    with figure_style():
        for name, makers in MAKERS.items():
            results = Results.read(folder, name)
            drawings += [maker(results) for maker in makers] if results is not None else []
    return drawings


def write_figures(drawings: list[Drawing], out: Path) -> list[Path]:
    """Write each figure as `<out>/<name>.png`."""
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    with figure_style():
        for drawing in drawings:
            path = out / f"{drawing.name}.png"
            with atomic_write(path) as file:
                file.write(png_bytes(drawing.figure))
            paths.append(path)
    return paths


def main() -> None:
    """Write every figure that can be made."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.figures", description="Draw figures from results files."
    )
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--out", type=Path, default=Path("results/figures"))
    options = parser.parse_args()
    for path in write_figures(all_figures(options.results), options.out):
        print(path)


if __name__ == "__main__":
    main()
