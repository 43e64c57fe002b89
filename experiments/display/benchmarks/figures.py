"""Figures of the benchmarks: speed beside other libraries, scaling, denoising."""

import numpy as np

from cablejax.report import COLORS, line_styles
from experiments.analysis.benchmark import Benchmark
from experiments.display.benchmarks.speed_tables import Found, races
from experiments.display.drawing import Drawing, new_figure

HATCHES = ("", "//", "..", "xx")
EVEN = 1.0
SCALED = {
    "open3d": "Open3D",
    "scipy search": "SciPy, search alone",
    "pykdtree search": "pykdtree, search alone",
}


def speed(found: Found) -> Drawing | None:
    """How many times as fast as each peer, with the spread of the peer's runs."""
    peers = [race for race in races(found) if race.seconds != race.ours]
    if not peers:
        return None
    figure = new_figure(6.6, 0.9 + 0.36 * len(peers))
    ax = figure.subplots()
    at = np.arange(len(peers))[::-1]
    ratio = np.array([race.seconds / race.ours for race in peers])
    low, high = np.array([np.array(race.quartiles) / race.ours for race in peers]).T
    colors = [COLORS[0] if value >= EVEN else COLORS[1] for value in ratio]
    ax.barh(at, ratio - EVEN, left=EVEN, height=0.62, color=colors, ec="0.2", lw=0.5)
    ax.errorbar(ratio, at, xerr=[ratio - low, high - ratio], fmt="none", ecolor="0.2", lw=1, capsize=2)
    ax.axvline(EVEN, color="0.2", lw=1, ls="-")
    ax.set_xscale("log")
    ticks = [0.2, 0.5, 1, 2, 5, 10]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.minorticks_off()
    ax.set_xlim(min(0.25, 0.6 * ratio.min()), max(2.5, 1.9 * ratio.max()))
    for y, value in zip(at, ratio, strict=True):
        side = "left" if value >= EVEN else "right"
        ax.annotate(f"{value:.2f}", (value, y), (8 if side == "left" else -8, 0), textcoords="offset points", ha=side,
                    va="center", fontsize=9)  # fmt: skip
    ax.set_yticks(at, [f"{race.task}: {race.peer}" for race in peers])
    ax.set_xlabel("peer's time / ours (above 1 ours is faster)")
    ax.grid(visible=False, axis="y")
    return Drawing(
        "speed",
        figure,
        "Time of other libraries over ours for each kernel, on a logarithmic axis.",
        "Warm time of each peer over ours, on the same data in the same process; whiskers are the quartiles of the peer's runs. "
        "Blue bars to the right: ours is the faster; orange bars to the left: the peer is.",
    )


def scaling(results: Benchmark) -> Drawing:
    """Seconds and peak memory of outlier removal against the number of points."""
    figure = new_figure(6.6, 3.1)
    axes = figure.subplots(1, 2)
    names = dict.fromkeys(row["contender"] for row in results.rows("rows"))
    for style, name in zip(line_styles(), names, strict=False):
        rows = [row for row in results.rows("rows") if row["contender"] == name]
        points = [row["points"] for row in rows]
        for ax, key in zip(axes, ("run_s", "peak_gb"), strict=True):
            ax.loglog(points, [row[key] for row in rows], marker="o", ms=4, label=SCALED.get(name, name), **style)
    for ax, title in zip(axes, ("(a) warm run (s)", "(b) peak memory of the process (GB)"), strict=True):
        ax.set_xlabel("points")
        ax.set_title(title, loc="left", fontsize=10)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return Drawing(
        "scaling",
        figure,
        "Seconds and peak memory of statistical outlier removal against the number of points.",
        "Statistical outlier removal, k 20, each size and library in a process of its own. Both axes are logarithmic: a straight "
        "line of slope 1 is a cost in proportion to the points.",
    )


def denoise(results: Benchmark) -> Drawing:
    """Chamfer distance of each method on PCNet's shapes, tuned on and held out."""
    levels = list(dict.fromkeys(row["level"] for row in results.rows("rows")))
    methods = list(dict.fromkeys(_method(row["method"]) for row in results.rows("rows")))
    figure = new_figure(6.6, 3.2)
    axes = figure.subplots(1, 2, sharey=True)
    width = 0.8 / len(methods)
    for ax, part, title in zip(axes, ("tuned", "held_out"), ("shapes tuned on", "shapes held out"), strict=True):
        for i, method in enumerate(methods):
            rows = {row["level"]: row for row in results.rows("rows") if _method(row["method"]) == method}
            at = np.arange(len(levels)) + (i - (len(methods) - 1) / 2) * width
            heights = [rows[level][part] for level in levels]
            ax.bar(at, heights, width, label=method, color=COLORS[i], hatch=HATCHES[i % len(HATCHES)], ec="white")
        ax.set_xticks(range(len(levels)), [f"{100 * float(level):g} %" for level in levels])
        ax.set_xlabel("noise (of the shape's radius)")
        ax.set_title(f"five {title}", loc="left", fontsize=10)
        ax.grid(visible=False, axis="x")
    axes[0].set_ylabel("10⁴ Chamfer distance (0 is best)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return Drawing(
        "denoise",
        figure,
        "Chamfer distance of the noisy clouds and of three methods at three levels of noise.",
        "PCNet's ten shapes of 10,000 points. The filter was not made for these free-form shapes and has one setting for all "
        "levels; bilateral filter and moving least squares had theirs chosen for each level.",
    )


def _method(name: str) -> str:
    """A method without the setting that differs from level to level."""
    return name if name.startswith("cablejax") else name.split(",")[0]
