"""Tables of the measured diameter: how often the interval holds the truth, and real scans."""

from experiments.analysis.benchmark import Benchmark
from experiments.display.table import Table

GROUPS = {
    "all": "all scans",
    "preset": "scanner",
    "shape": "shape",
    "arc_deg": "arc seen",
    "order": "order of the points",
}


METHODS = {
    "RANSAC cylinder": "RANSAC cylinder",
    "in scan order": "cablejax, rows in scan order",
    "shuffled": "cablejax, rows shuffled",
}


def accuracy(results: Benchmark) -> Table:
    """Error of the diameter on simulated scans, beside the straight cylinder that is commonly fitted."""
    table = results.rows("summary")
    rows = [
        [
            f"{row['row']}: {METHODS[row['method']]}",
            f"{row['scans'] - row['refused']} of {row['scans']}",
            f"{row['rmse_mm']:.4f}",
            f"{row['bias_mm']:+.4f}",
            f"{100 * row['coverage']:.0f}" if "coverage" in row else "",
            f"{100 * row['nominal_right']:.0f}" if "nominal_right" in row else "",
        ]
        for row in table
        if row.get("method") in METHODS
    ]
    cad = next((row for row in table if row["row"] == "Fit4CAD"), None)
    beside = (
        ""
        if cad is None
        else f" On {cad['cylinders']} CAD cylinders (Fit4CAD, noise of 0.5 % of the radius) the radius is off by "
        f"{cad['mean_percent']:.2f} % on average, {cad['p90_percent']:.2f} % at the 90th percentile."
    )
    return Table(
        "Accuracy of the diameter on simulated scans",
        ["Scan: method", "measured", "RMSE (mm)", "bias (mm)", "interval holds truth (%)", "size right (%)"],
        rows,
        "Line-laser scans of all 13 sizes. In scan order the sweeps of the scanner show and their shifts are fitted; shuffled "
        "rows hide them, which costs accuracy and widens the interval." + beside,
    )


def name_of(row: dict) -> str:
    """A group of scans in words: "arc seen: 90°"."""
    if row["by"] == "all":
        return GROUPS["all"]
    value = f"{row['of']:g}°" if row["by"] == "arc_deg" else f"{row['of']}"
    return f"{GROUPS[row['by']]}: {value}"


def coverage(results: Benchmark) -> Table:
    """How often the 95 % interval holds the truth, by what the scans have in common."""
    rows = [
        [
            name_of(row),
            f"{row['scans']}",
            f"{row['refused']}",
            f"{100 * row['coverage']:.0f}",
            f"{100 * row['coverage_low']:.0f} to {100 * row['coverage_high']:.0f}",
            f"{row['rmse_mm']:.4f}",
            f"{row['rms_std_mm']:.4f}",
        ]
        for row in groups(results)
    ]
    return Table(
        "Does the 95 % interval of the diameter hold the truth?",
        ["Scans", "scans", "refused", "hold (%)", "95 % of that (%)", "RMS error (mm)", "RMS claimed std (mm)"],
        rows,
        "Simulated scans with known truth. The share that holds should be 95 %, with its own Wilson interval beside it; the root "
        "mean square of the error should be near that of the standard deviation that the measurement claims. Refused: the scan "
        "shows too little to give a diameter.",
    )


def groups(results: Benchmark) -> list[dict]:
    """The groups of the coverage table that say more than the row of all scans does."""
    table = results.rows("summary")
    alone = {row["by"] for row in table if sum(other["by"] == row["by"] for other in table) == 1} - {"all"}
    return [row for row in table if row["by"] not in alone]


def real_scans(results: Benchmark) -> Table | None:
    """Real scans, none of which is a cable: measured, and what is known of them."""
    rows = [_real_scan(row) for row in results.rows("summary") if row["row"] == "real file"]
    if not rows:
        return None
    return Table(
        "Real scans",
        ["What", "points", "diameter (mm)", "95 % interval (mm)", "known", "what the measurement says of itself"],
        rows,
        "No public scan of a power cable with a diameter by calliper is known to us. These are round things from public test "
        "data, and what is known of them is another program's value, not a calliper's.",
    )


def _real_scan(row: dict) -> list[str]:
    measured = row.get("diameter_mm")
    known = "" if row["known_mm"] is None else f"{row['known_mm']:g} mm: "
    return [
        row["what"],
        f"{row['points']:,}",
        "refused" if measured is None else f"{measured:.1f}",
        "" if measured is None else "{:.1f} to {:.1f}".format(*row["interval_mm"]),
        known + row["known_from"],
        row["refused"] if measured is None else "; ".join(row["warnings"]),
    ]


def real_grades(results: Benchmark) -> Table:
    """Real scans of known size by the grade of their truth: which intervals hold."""
    told = {
        "A": "A, published and confirmed on a mesh",
        "B": "B, CAD or the part's name",
        "C": "C, an independent fit or common sense",
        "R": "R, repeatability alone",
        "A, B, C": "A, B and C together",
    }
    rows = []
    for row in results.rows("summary"):
        if row["grade"] in told:
            share = "" if row["share_held"] is None else f"{100 * row['share_held']:.0f}"
            counts = [str(row[name]) for name in ("scans", "holds", "misses", "refused", "false cable", "failed")]
            rows.append([told[row["grade"]], *counts, share])
    return Table(
        "Real scans of known size",
        ["Truth", "scans", "interval holds", "misses", "refused", "false cables", "failed", "held (%)"],
        rows,
        "Cans, motors, pins, stems, tubes and boxes under structured light, depth cameras and hand-held lasers. A false cable is "
        "a diameter where there are boxes alone.",
    )
