"""Tables of filtering and of the diameter: ours beside the paper's."""

from collections.abc import Callable
from typing import Any

from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.display.table import Table, told

NOISES = ("gaussian", "random", "compound")
Cell = dict[str, Any]
FILTERS = ("statistical", "radius", "median", "adaptive")  # the paper's, in its order


def filters_of(results: Results) -> list[str]:
    """The paper's filters, then what else was run."""
    return [*FILTERS, *(name for name in results.values("filter.name") if name not in FILTERS)]


def table1(results: Results) -> Table:
    """Table 1 in the paper's columns: remaining points and seconds, ours and the paper's."""
    rows = []
    for name in filters_of(results):
        row = [NAMES[name]]
        for noise in NOISES:
            cell = {"filter__name": name, "noise__kind": noise}
            theirs = paper.TABLE_1.get(name, {}).get(noise)
            row += [
                f"{results.mean('remaining', **cell).mean:,.0f}",
                f"{theirs[0]:,}" if theirs else "",
                f"{results.mean('seconds', **cell).mean:.3f}",
                f"{theirs[1]:.3f}" if theirs else "",
            ]
        rows.append(row)
    header = ["Filter", *["points", "paper", "s", "paper"] * len(NOISES)]
    return Table(
        "Table 1: points remaining and seconds",
        header,
        rows,
        f"Of {results.config('scan.n_points'):,} points, {told(results)}. The paper's scan is another one and its "
        "noise level is not given, so the counts are not comparable; warm run time, compilation apart.",
        [("", 1), *[(f"{NAMES[noise]} noise", 4) for noise in NOISES]],
    )


def table1_truth(results: Results) -> Table:
    """What the paper could not show: whether the points removed were the wrong ones."""
    rows = []
    for name in filters_of(results):
        for noise in NOISES:
            cell = {"filter__name": name, "noise__kind": noise}
            rows.append(
                [
                    f"{NAMES[name]}, {NAMES[noise].lower()}",
                    *[results.mean(metric, **cell).format(3) for metric in ("precision", "recall", "f1")],
                    *[results.mean(metric, **cell).format(3) for metric in ("rms_mm", "diameter_bias_mm")],
                    f"{max(row['compile_seconds'] for row in results.rows(**cell)):.1f}",
                ]
            )
    return Table(
        "Table 1 against the truth",
        ["Filter, noise", "precision", "recall", "F1", "RMS (mm)", "diameter bias (mm)", "compile (s)"],
        rows,
        "Removal of the simulated outliers, then the remaining points' distance to the true surface; the diameter bias is "
        f"twice their median signed distance. Compilation of the first seed; {told(results)}.",
    )


def table1_outliers(results: Results) -> Table:
    """Table 1 by the share of outliers in the scan."""
    shares = results.values("scan.outlier_fraction")
    return _side_by_side(
        "Table 1 by share of outliers",
        results,
        {f"{100 * share:g} % outliers": {"scan__outlier_fraction": share} for share in shares},
        {"removed (%)": _removed, "F1": _mean("f1"), "RMS (mm)": _mean("rms_mm")},
        "The paper's filters remove 32 to 43 % of its points; how many of those were outliers it does not say. Each filter "
        "keeps the threshold that was chosen at 2 %.",
    )


def table1_noise(results: Results) -> Table:
    """Table 1 by strength and kind of the noise."""
    conditions = {
        f"{snr:g} dB, {NAMES[noise].lower()}": {"noise__snr_db": snr, "noise__kind": noise}
        for snr in reversed(results.values("noise.snr_db"))
        for noise in NOISES
    }
    return _side_by_side(
        "Table 1 by strength of the noise",
        results,
        conditions,
        {"removed (%)": _removed, "impulses (%)": _impulses, "RMS (mm)": _mean("rms_mm")},
        "Impulses: of the points that impulsive noise threw more than 1.5 mm off the surface, the share removed. All kinds "
        "have the same power at the same ratio.",
    )


def _side_by_side(
    title: str,
    results: Results,
    conditions: dict[str, Cell],
    columns: dict[str, Callable[[Results, Cell], str]],
    caption: str,
) -> Table:
    """A row a condition, the paper's filters side by side."""
    rows = [
        [label, *[column(results, {**cell, "filter__name": name}) for name in FILTERS for column in columns.values()]]
        for label, cell in conditions.items()
    ]
    return Table(
        title,
        ["Scan", *[*columns] * len(FILTERS)],
        rows,
        f"{caption} Of {results.config('scan.n_points'):,} points, size {results.size}, means of {len(results.seeds)} seeds.",
        [("", 1), *[(NAMES[name], len(columns)) for name in FILTERS]],
    )


def _mean(metric: str) -> Callable[[Results, Cell], str]:
    return lambda results, cell: f"{results.mean(metric, **cell).mean:.3f}"


def _removed(results: Results, cell: Cell) -> str:
    return f"{removed_percent(results, **cell):.1f}"


def _impulses(results: Results, cell: Cell) -> str:
    found = [100 * row["impulses_removed"] for row in results.rows(**cell) if "impulses_removed" in row]
    return f"{sum(found) / len(found):.1f}" if found else ""


def removed_percent(results: Results, **cell: Any) -> float:
    """Share of the scan's points that a filter took away."""
    return 100 * (1 - results.mean("remaining", **cell).mean / results.config("scan.n_points"))


def table2_3(results: Results) -> Table:
    """Tables 2 and 3: deviation before and after, by signal-to-noise ratio and order of the filter."""
    rows = []
    for snr in results.values("noise.snr_db"):
        theirs = {"before": paper.TABLE_2.get(int(snr)), "after": paper.TABLE_3.get(int(snr))}
        first = {"noise__snr_db": snr, "filter__order": results.values("filter.order")[0]}
        rows.append([f"{snr:g} dB, before", *_deviation(results, "before", first), "", *_paper_cells(theirs["before"])])
        for order in results.values("filter.order"):
            cell = {"noise__snr_db": snr, "filter__order": order}
            rows.append(
                [
                    f"{snr:g} dB, after, order {order}",
                    *_deviation(results, "after", cell),
                    results.mean("diameter_bias_mm", **cell).format(4),
                    *(_paper_cells(theirs["after"]) if order == 0 else ["", "", ""]),
                ]
            )
    return Table(
        "Tables 2 and 3: deviation from the true surface before and after filtering",
        [
            "Noise",
            "mean (mm)",
            "std (mm)",
            "within (%)",
            "diameter bias (mm)",
            "paper mean",
            "paper std",
            "paper within",
        ],
        rows,
        f"Within: share inside ±{results.config('tolerance_mm'):g} mm. Order 0 is the paper's filter, 1 fits a plane, 2 a "
        f"quadric on the same weights; {told(results)}. The paper's spread of 0.385 mm cannot be noise of 60-120 dB; "
        "it is simulated as the scanner's floor.",
    )


def _deviation(results: Results, when: str, cell: dict[str, object]) -> list[str]:
    return [
        results.mean(f"{when}.{metric}", **cell).format(digits)
        for metric, digits in (("mean_mm", 4), ("std_mm", 4), ("within_percent", 1))
    ]


def _paper_cells(row: tuple[float, float, float] | None) -> list[str]:
    return ["", "", ""] if row is None else [f"{row[0]:.4f}", f"{row[1]:.4f}", f"{row[2]:.2f}"]


def diameter(results: Results) -> Table:
    """The measured diameter of simulated scans beside the truth."""
    rows = []
    for preset in results.values("scan.preset"):
        for seed, row in zip(results.seeds, results.rows(scan__preset=preset), strict=True):
            for kind in ("raw", "filtered"):
                m = row[kind]
                low, high = m["interval_mm"]
                rows.append(
                    [
                        f"{preset}, seed {seed}, {kind}",
                        f"{row['true_diameter_mm']:.3f}",
                        f"{m['diameter_mm']:.3f}",
                        f"{m['diameter_mm'] - row['true_diameter_mm']:+.4f}",
                        f"{low:.3f} - {high:.3f}",
                        "yes" if low <= row["true_diameter_mm"] <= high else "no",
                        f"{row[f'{kind}_seconds']:.1f}",
                    ]
                )
    return Table(
        "Diameter of the simulated scan",
        ["Scanner, seed, points", "true (mm)", "measured (mm)", "error (mm)", "95 % interval (mm)", "holds truth", "s"],
        rows,
        f"`measure_cable` on {results.config('scan.n_points'):,} points, before and after the adaptive filter of order "
        f"{results.config('filter.order')}. Filtered points are no longer independent, so that "
        "their interval may come out too narrow: measure raw ones. "
        f"Size {results.size}.",
    )
