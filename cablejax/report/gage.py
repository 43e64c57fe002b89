"""The chart of a gage study: components, values by part, ranges and means by operator."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from cablejax.optional import require
from cablejax.report.style import COLORS, figure_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Constants of control charts by size of subgroup, 2 to 10 (AIAG SPC, appendix): means, and upper limit of ranges.
A2 = (1.880, 1.023, 0.729, 0.577, 0.483, 0.419, 0.373, 0.337, 0.308)
D4 = (3.267, 2.574, 2.282, 2.114, 2.004, 1.924, 1.864, 1.816, 1.777)


def gage_chart(
    parts: Sequence[str], operators: Sequence[str], values: Float[np.ndarray, "parts operators trials"], study: Any
) -> "Figure":
    """Draw a study.

    Limits of means and ranges are those of control charts, for 2 to 10 trials: in a gage that sees the parts, most means lie
    beyond theirs, and all ranges within.

    Args:
        parts, operators: Names, as in `values`.
        values: Measurements in mm.
        study: The `GageStudy` of them.
    """
    require("matplotlib", why="a chart")
    from matplotlib.figure import Figure

    with figure_style():
        figure = Figure(figsize=(9.0, 6.4))
        axes = figure.subplots(2, 2)
        _components(axes[0, 0], study)
        _by_part(axes[0, 1], parts, operators, values)
        _control(axes[1, 0], parts, operators, values, ranges=True)
        _control(axes[1, 1], parts, operators, values, ranges=False)
        handles, labels = axes[0, 1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=min(len(operators), 6))
        figure.canvas.draw()
    return figure


def _components(ax: Any, study: Any) -> None:
    names = ("GRR", "EV", "AV", "parts")
    shares = [100 * getattr(study, name) / study.total for name in ("gage", "repeatability", "reproducibility", "part")]
    ax.bar(names, shares, color=COLORS[0], width=0.6)
    ax.axhline(10, color=COLORS[2], lw=1, ls="--")
    ax.axhline(30, color=COLORS[2], lw=1, ls="-")
    ax.set_ylabel("% of total variation")
    ax.set_title(f"%GRR {study.percent_gage:.1f}, ndc {study.categories}: {study.verdict}", fontsize=9)


def _by_part(ax: Any, parts: Sequence[str], operators: Sequence[str], values: np.ndarray) -> None:
    places, trials = np.arange(len(parts)), values.shape[2]
    for i, operator in enumerate(operators):
        shift = 0.5 * ((i + 0.5) / len(operators) - 0.5)
        ax.plot(
            np.repeat(places + shift, trials),
            values[:, i].ravel(),
            ".",
            ms=5,
            color=COLORS[i % len(COLORS)],
            label=operator,
        )
    ax.plot(places, values.mean(axis=(1, 2)), "-", lw=1, color="0.5")
    _named(ax, parts)
    ax.set_ylabel("diameter (mm)")
    ax.set_title("by part", fontsize=9)


def _control(ax: Any, parts: Sequence[str], operators: Sequence[str], values: np.ndarray, *, ranges: bool) -> None:
    shown = np.ptp(values, axis=2) if ranges else values.mean(axis=2)
    for i in range(len(operators)):
        ax.plot(np.arange(len(parts)), shown[:, i], "o-", ms=3, lw=1, color=COLORS[i % len(COLORS)])
    spread, size = float(np.ptp(values, axis=2).mean()), values.shape[2] - 2
    middle = spread if ranges else float(values.mean())
    ax.axhline(middle, color="0.3", lw=1)
    if size < len(A2):
        limits = (D4[size] * spread,) if ranges else (middle - A2[size] * spread, middle + A2[size] * spread)
        for limit in limits:
            ax.axhline(limit, color=COLORS[2], lw=1, ls="--")
    _named(ax, parts)
    ax.set_ylabel("range (mm)" if ranges else "mean (mm)")
    ax.set_title("range of the trials" if ranges else "mean of the trials", fontsize=9)


def _named(ax: Any, parts: Sequence[str]) -> None:
    ax.set_xticks(np.arange(len(parts)), parts, rotation=90 if max(map(len, parts)) > 3 else 0, fontsize=8)
