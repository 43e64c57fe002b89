"""Figures of filtering and of the diameter."""

from typing import TYPE_CHECKING, Any

import numpy as np

from cablejax.report import COLORS, line_styles, point_views
from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.display.drawing import Drawing, new_figure
from experiments.display.filtering.tables import NOISES, removed_percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def deviation(results: Results) -> Drawing:
    """Tables 2 and 3: spread and share within tolerance, before and after, ours and the paper's."""
    figure = new_figure(6.6, 3.4)
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
    figure = new_figure(6.6, 3.2)
    ax: Axes = figure.subplots()
    noises = [noise for noise in NOISES if noise in results.values("noise.kind")]
    names = [name for name in paper.TABLE_1 if name in results.values("filter.name")]
    for i, (name, marker) in enumerate(zip(names, ("o", "s", "^", "D"), strict=False)):
        values = [results.mean("f1", filter__name=name, noise__kind=noise) for noise in noises]
        spread = [0.0 if np.isnan(v.half_width) else v.half_width for v in values]
        at = np.arange(len(noises)) + 0.12 * (i - (len(names) - 1) / 2)
        ax.errorbar(at, [v.mean for v in values], spread, fmt=marker, ms=5, capsize=3, lw=1.2, color=COLORS[i],
                    label=NAMES[name])  # fmt: skip
    ax.set_xticks(range(len(noises)), [f"{NAMES[noise]} noise" for noise in noises])
    ax.set_xlim(-0.5, len(noises) - 0.5)
    ax.set_ylabel("F1 of removal (1 is best)")
    ax.grid(visible=False, axis="x")
    figure.legend(loc="outside lower center", ncols=4)
    return Drawing(
        "removal",
        figure,
        "F1 score of outlier removal for four filters and three kinds of noise, with 95 % intervals.",
        "Table 1 against the truth: F1 of removing the simulated outliers, mean over seeds with its 95 % interval. The axis "
        "does not begin at 0. Fewer points left is not better by itself.",
    )


def outlier_shares(results: Results) -> Drawing:
    """Table 1 by the share of outliers: how well they are found, and how much is taken away."""
    figure = new_figure(6.6, 3.4)
    left, right = figure.subplots(1, 2)
    shares = results.values("scan.outlier_fraction")
    percent = [100 * share for share in shares]
    for style, name in zip(line_styles(), paper.TABLE_1, strict=False):
        cells = [{"filter__name": name, "scan__outlier_fraction": share} for share in shares]
        values = [results.mean("f1", **cell) for cell in cells]
        spread = [0.0 if np.isnan(v.half_width) else v.half_width for v in values]
        left.errorbar(
            percent, [v.mean for v in values], spread, label=NAMES[name], marker="o", ms=4, capsize=3, **style
        )
        right.plot(percent, [removed_percent(results, **cell) for cell in cells], marker="o", ms=4, **style)
    right.axhspan(*_removed_in_the_paper(), color="0.85", lw=0, label="the paper's filters, of its own scan")
    right.plot(percent, percent, color="0.4", lw=1, ls=":", label="as many as there are outliers")
    left.set_ylabel("F1 of removal (1 is best)")
    left.set_ylim(0, 1.02)
    right.set_ylabel("points removed (%)")
    right.set_ylim(bottom=0)
    for ax in (left, right):
        ax.set_xlabel("outliers in the scan (%)")
    handles = [
        [*first, *second]
        for first, second in zip(*(ax.get_legend_handles_labels() for ax in (left, right)), strict=True)
    ]
    figure.legend(*handles, loc="outside lower center", ncols=3)
    return Drawing(
        "outlier_shares",
        figure,
        "F1 of outlier removal and the share of points removed against the share of outliers, for four filters.",
        "Left, how well each filter finds the outliers, mean over seeds with its 95 % interval; right, how many points it takes "
        "away. Thresholds are those chosen at 2 %. The grey band is what the paper's filters take from its own scan.",
    )


def _removed_in_the_paper() -> tuple[float, float]:
    kept = [points for filters in paper.TABLE_1.values() for points, _ in filters.values()]
    return 100 * (1 - max(kept) / paper.SCAN_POINTS), 100 * (1 - min(kept) / paper.SCAN_POINTS)


def section(results: Results) -> Drawing:
    """A slice of the scan before and after filtering, on the true circle."""
    view = results.rows(scan__preset=results.values("scan.preset")[-1])[0]["view"]
    radius = view["radius_mm"]
    figure = new_figure(6.6, 3.9)
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


def scan_clouds(results: Results) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], dict[str, Any]]:
    """The scan before and after filtering with its deviation, and how a view of it is labelled and coloured."""
    view = results.rows(scan__preset=results.values("scan.preset")[-1])[0]["view"]
    clouds = {
        kind: (np.asarray(view[kind]["xyz_mm"]), np.asarray(view[kind]["deviation_mm"])) for kind in ("raw", "filtered")
    }
    return clouds, {"label": "deviation (mm)", "limit": 3 * view["scale_mm"]}


def scan_views(results: Results) -> Drawing:
    """The scan from the side, coloured by deviation."""
    clouds, look = scan_clouds(results)
    return Drawing(
        "scan",
        point_views(clouds, **look),
        "The simulated scan from the side before and after filtering, coloured by deviation from the true surface.",
        "The scan before and after filtering; colour is the signed distance to the true surface.",
    )
