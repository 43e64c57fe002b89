"""Tables 1, 2 and 3 in the paper's own layout, each of its values beside ours."""

from collections.abc import Callable
from pathlib import Path

from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.display.filtering.tables import FILTERS, NOISES
from experiments.display.table import Table, told


def paper_tables(folder: Path) -> list[Table]:
    """Those of the three tables whose results are in the folder."""
    filtering, deviation = (Results.read(folder, name) for name in ("table1_filtering", "table2_3_deviation"))
    tables = [] if filtering is None else [table1(filtering)]
    if deviation is not None:
        tables += [table2_or_3(deviation, "before"), table2_or_3(deviation, "after")]
    return tables


def table1(results: Results) -> Table:
    """Table 1: remaining points and time for each kind of noise and their means, the paper's in brackets."""
    rows = []
    for name in FILTERS:
        points = [results.mean("remaining", filter__name=name, noise__kind=noise).mean for noise in NOISES]
        seconds = [results.mean("seconds", filter__name=name, noise__kind=noise).mean for noise in NOISES]
        theirs = [paper.TABLE_1[name][noise] for noise in NOISES]
        row = ["The algorithm of this article" if name == "adaptive" else f"{NAMES[name]} filtering"]
        for ours, other in zip(zip(points, seconds, strict=True), theirs, strict=True):
            row += [f"{ours[0]:,.0f} ({other[0]:,})", f"{ours[1]:.3f} ({other[1]:.3f})"]
        row += [
            f"{_mean(points):,.0f} ({_mean([t[0] for t in theirs]):,.0f})",
            f"{_mean(seconds):.3f} ({_mean([t[1] for t in theirs]):.3f})",
        ]
        rows.append(row)
    header = ["Algorithm type", *["remaining point", "time/s"] * (len(NOISES) + 1)]
    groups = [("", 1), *[(f"{NAMES[noise]} noise", 2) for noise in NOISES], ("Means", 2)]
    return Table(
        "Table 1: Experimental results of 3D point cloud data preprocessing",
        header,
        rows,
        f"Ours (the paper's). {told(results)}.",
        groups,
    )


def table2_or_3(results: Results, when: str) -> Table:
    """Table 2 (before) or 3 (after): deviation by noise intensity and its mean, the paper's in brackets."""
    theirs = paper.TABLE_2 if when == "before" else paper.TABLE_3

    def value(metric: str, snr: float) -> float:
        return results.mean(f"{when}.{metric}", noise__snr_db=snr, filter__order=0).mean

    formats: tuple[tuple[str, Callable[[float], str]], ...] = (
        ("mean_mm", lambda x: f"{x:.4f}"),
        ("std_mm", lambda x: f"{x:.4f}"),
        ("within_percent", lambda x: f"{x:.2f}%"),
    )
    rows = []
    for snr in theirs:
        cells = [f"{show(value(m, snr))} ({show(theirs[snr][i])})" for i, (m, show) in enumerate(formats)]
        rows.append([f"{snr:g}", *cells])
    means = [
        f"{show(_mean([value(m, snr) for snr in theirs]))} ({show(_mean([row[i] for row in theirs.values()]))})"
        for i, (m, show) in enumerate(formats)
    ]
    rows.append(["Mean", *means])
    return Table(
        f"Table {2 if when == 'before' else 3}: Deviation analysis data {when} denoising",
        [
            "Noise intensity (dB)",
            "Average deviation (mm)",
            "Standard deviation (mm)",
            "Proportion within the tolerance",
        ],
        rows,
        f"Ours with order 0 (the paper's in brackets). Tolerance ±{results.config('tolerance_mm'):g} mm. {told(results)}.",
    )


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
