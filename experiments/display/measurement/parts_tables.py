"""Tables of what is told to the measurement beside the scan: labels by a network, the scanner's own numbers."""

import numpy as np

from cablejax.geometry.robust import COVERAGE
from experiments.analysis.benchmark import Benchmark
from experiments.analysis.results import Results
from experiments.display.table import Table

BENCHMARK, PLAIN, KNOWN = "benchmarks/parts", "benchmarks/coverage", "benchmarks/coverage_known"
WAYS = {"without": "search", "auto": "default", "network": "labels", "truth": "truth"}


def labels(results: Results) -> Table:
    """How well each part's points are told, on simulated scenes that were not trained on."""
    metrics = results.rows()[0]
    confusion = np.array(metrics["test_confusion"])
    rows = [
        [
            part,
            f"{100 * share:.1f}",
            f"{100 * metrics['test_recall'][part]:.1f}",
            f"{100 * metrics['test_iou'][part]:.1f}",
        ]
        for part, share in zip(metrics["parts"], confusion.sum(axis=1) / confusion.sum(), strict=True)
    ]
    rows.append(["all", "100", f"{100 * metrics['test_overall']:.1f}", f"{100 * metrics['test_mean_iou']:.1f}"])
    return Table(
        "Points labelled by part",
        ["Part", "share of the points (%)", "labelled rightly (%)", "intersection over union (%)"],
        rows,
        f"{results.config('parts.test'):,} simulated scenes of cables with joints, stress cones, terminations and clamps, on "
        "saddles, in trays, before walls and beside other cables, by four scanners; trained on "
        f"{results.config('parts.train'):,} others for {results.config('training.epochs')} epochs, the best on validation taken. "
        'One seed. "All" is the share of all points, and the mean of the parts\' intersections over unions.',
    )


def measured(results: Benchmark) -> Table:
    """How often the diameter comes out right among other things, without labels, with a network's and with the true ones."""
    table = results.rows("summary")
    rows, shown = [], [way for way in WAYS if any(row["way"] == way for row in table)]
    for scene in dict.fromkeys(row["scene"] for row in table):
        ways = {row["way"]: row for row in table if row["scene"] == scene}
        counts = [f"{ways[way]['right']} of {ways[way]['scans']}" for way in shown]
        middle = [f"{ways[way]['median_mm']:.3f}" if ways[way]["median_mm"] is not None else "" for way in shown]
        rows.append([scene, *counts, *middle])
    return Table(
        "Cables among other things",
        ["Scene", *[WAYS[way] for way in shown] * 2],
        rows,
        "Simulated scans of 20,000 points by three scanners, over half and over all of the circumference, by the same fit: by "
        "the search in all points; as `cablejax measure` does by default, with labels where they do not confirm what the search "
        "finds; and of the points alone that the network of the package takes for a cable's, or, under truth, that are one's. "
        "On a joint the search measures the joint, which is round too.",
        [("", 1), ("within 2 %", len(shown)), ("median error (mm)", len(shown))],
    )


def known_scanner(found: dict[str, Benchmark]) -> Table | None:
    """Error and claim on the same scans without and with the scanner's own numbers."""
    if PLAIN not in found or KNOWN not in found:
        return None
    plain, known = ({row["index"]: row for row in found[name].rows("scans")} for name in (PLAIN, KNOWN))
    both = [
        (plain[i], known[i])
        for i in known
        if i in plain and plain[i]["order"] == "in scan order" and "error_mm" in plain[i] and "error_mm" in known[i]
    ]
    rows = []
    for preset in dict.fromkeys(one["preset"] for one, _ in both if one["preset"] != "ideal"):
        mine = [pair for pair in both if pair[0]["preset"] == preset]
        error, std = (np.array([[one[name] for one in pair] for pair in mine]) for name in ("error_mm", "std_mm"))
        holds = np.mean(np.abs(error) < COVERAGE * std, axis=0)
        rows.append(
            [
                preset,
                f"{len(mine)}",
                *(f"{value:+.4f}" for value in error.mean(axis=0)),
                *(f"{value:.4f}" for value in np.sqrt(np.mean(error**2, axis=0))),
                *(f"{value:.4f}" for value in np.sqrt(np.mean(std**2, axis=0))),
                *(f"{100 * value:.0f}" for value in holds),
            ]
        )
    return Table(
        "A scanner that is known",
        [
            "Scanner",
            "scans",
            "unknown",
            "known",
            "unknown ",
            "known ",
            "unknown  ",
            "known  ",
            "unknown   ",
            "known   ",
        ],
        rows,
        "The same simulated scans, rows in scan order, measured without and with `--scanner`: the fitted cable is scanned anew "
        "with the scanner's numbers, and what that does to the diameter is taken off.",
        [
            ("", 2),
            ("mean error (mm)", 2),
            ("RMS error (mm)", 2),
            ("RMS claimed std (mm)", 2),
            ("interval holds truth (%)", 2),
        ],
    )
