"""Figures of the measured diameter: coverage of the interval, and errors beside what was claimed."""

import numpy as np

from cablejax.geometry.robust import COVERAGE
from cablejax.report import COLORS
from experiments import ROOT
from experiments.analysis.benchmark import Benchmark
from experiments.display.drawing import Drawing, new_figure
from experiments.display.measurement.tables import groups, name_of

NOMINAL = 0.95
MARKERS = ("o", "s", "^", "D", "v")
FINEST_MM = 1e-4  # errors below are drawn there: the axes are logarithmic


def coverage(results: Benchmark) -> Drawing:
    """The share of intervals that hold the truth, for each group of scans."""
    rows = groups(results)
    figure = new_figure(6.6, 0.9 + 0.27 * len(rows))
    ax = figure.subplots()
    at = np.arange(len(rows))[::-1]
    share, low, high = (np.array([row[key] for row in rows]) for key in ("coverage", "coverage_low", "coverage_high"))
    ax.errorbar(share, at, xerr=[share - low, high - share], fmt="o", ms=4, lw=1.2, capsize=3, color=COLORS[0])
    ax.axvline(NOMINAL, color=COLORS[2], lw=1, ls="--")
    ax.annotate("95 %", (NOMINAL, len(rows) - 0.4), ha="center", va="bottom", annotation_clip=False, fontsize=9)
    ax.set_yticks(at, [f"{name_of(row)} ({row['scans'] - row['refused']})" for row in rows])
    ax.set_xlim(min(0.85, 0.98 * low.min()), 1.01)
    ax.set_xlabel("share of intervals that hold the truth")
    ax.grid(visible=False, axis="y")
    return Drawing(
        "coverage_groups",
        figure,
        "Share of intervals that hold the truth for each group of scans, beside 95 %.",
        "Coverage of the 95 % interval on simulated scans; in brackets the scans measured. A group is off only where its "
        "whiskers miss the dashed line: with twenty scans or fewer they are long.",
    )


def calibration(results: Benchmark) -> Drawing:
    """Each scan's error against the standard deviation that it claimed."""
    scans = [scan for scan in results.rows("scans") if scan.get("error_mm") is not None]
    presets = list(dict.fromkeys(scan["preset"] for scan in scans))
    figure = new_figure(6.6, 3.8)
    ax = figure.subplots()
    for i, preset in enumerate(presets):
        ours = [scan for scan in scans if scan["preset"] == preset]
        claimed = np.array([scan["std_mm"] for scan in ours])
        error = np.maximum(np.abs([scan["error_mm"] for scan in ours]), FINEST_MM)
        ax.plot(claimed, error, MARKERS[i % len(MARKERS)], ms=5, ls="none", color=COLORS[i], label=preset, alpha=0.8)
    ends = np.array([0.7 * min(s["std_mm"] for s in scans), 1.4 * max(s["std_mm"] for s in scans)])
    ax.plot(ends, COVERAGE * ends, color="0.2", lw=1, ls="--", label="end of the 95 % interval")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("standard deviation claimed (mm)")
    ax.set_ylabel("absolute error of the diameter (mm)")
    figure.legend(loc="outside lower center", ncols=3)
    return Drawing(
        "calibration",
        figure,
        "Absolute error of each simulated scan against the standard deviation that the measurement claimed.",
        "One mark a scan. Scans above the dashed line are those whose 95 % interval misses the truth: one in twenty should be. "
        f"Errors below {1000 * FINEST_MM:g} µm are drawn at that height.",
    )


def real_intervals(results: Benchmark) -> Drawing | None:
    """Each real scan's interval over its truth."""
    rows = [row for row in results.rows("scans") if row["verdict"] in ("holds", "misses")]
    if not rows:
        return None
    figure = new_figure(6.6, 0.8 + 0.16 * len(rows))
    ax = figure.subplots()
    for at, row in enumerate(reversed(rows)):
        true = min((float(one) for one in row["truth"].split(" or ")), key=lambda one: abs(one - row["diameter_mm"]))
        low, high = (end / true for end in row["interval_mm"])
        color = COLORS[0] if row["verdict"] == "holds" else COLORS[6]
        ax.plot([low, high], [at, at], color=color, lw=1.5, ls="-")
        ax.plot(row["diameter_mm"] / true, at, "o", ms=3, color=color)
    ax.axvline(1.0, color=COLORS[2], lw=1, ls="--")
    ax.set_yticks(range(len(rows)), [f"{row['scan']} ({row['grade']})" for row in reversed(rows)], fontsize=6)
    ax.set_xlabel("diameter and 95 % interval over the truth")
    ax.grid(visible=False, axis="y")
    return Drawing(
        "real_intervals",
        figure,
        "Diameter and 95 % interval of each real scan over its truth.",
        "One line a scan, with the grade of its truth; the dashed line is the truth. What misses it is in another colour.",
    )


def real_pictures(results: Benchmark) -> Drawing | None:
    """Three real scans whose interval holds and three that miss or are refused, as `benchmarks.real_pictures` drew them."""
    from matplotlib.image import imread

    path = ROOT / "results" / "figures" / "real_scans.png"
    if not path.is_file():
        return None
    picture = imread(path)
    figure = new_figure(6.6, 6.6 * picture.shape[0] / picture.shape[1])
    figure.set_layout_engine("none")  # the one axes is placed by hand
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.imshow(picture)
    ax.axis("off")
    return Drawing(
        "real_examples",
        figure,
        "Six real scans seen along their axes, with the fitted circle and the true one.",
        "Above, three whose interval holds; below, two that miss and one that is refused. Points in blue, "
        "the fitted circle in red, the true one dashed.",
    )
