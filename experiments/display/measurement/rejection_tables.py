"""Tables of what finding the cable first is worth: fits to all, kept and true points, and adgcnn_fit."""

from typing import Any

import numpy as np

from experiments.analysis.inference import wilson
from experiments.analysis.results import Results
from experiments.analysis.statistics import estimate
from experiments.display.table import Table


def _cells(results: Results) -> dict[tuple[str, int], list[dict[str, Any]]]:
    """The runs of each dataset and number of points, in order."""
    cells: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in sorted(results.runs, key=lambda row: (row["dataset"], row["n_points"], row["seed"])):
        cells.setdefault((row["dataset"], row["n_points"]), []).append(row)
    return cells


def ways(results: Results) -> Table:
    """Sizes by a fit to all points, to those kept, to the true ones, by likelihood, and by the network."""
    rows = []
    for (dataset, n_points), found in _cells(results).items():
        called, right = (sum(row["reliability"][key] for row in found) for key in ("called_90", "called_90_right"))
        rows.append(
            [
                dataset,
                f"{n_points:,}",
                f"{found[0]['all']['accuracy']:.3f}",
                estimate([row["kept"]["accuracy"] for row in found]).format(3),
                f"{found[0]['true']['accuracy']:.3f}",
                f"{found[0]['likelihood']['accuracy']:.3f}",
                estimate([row["adgcnn_fit"]["accuracy"] for row in found]).format(3),
                f"{np.mean([row['adgcnn_fit']['median_error_mm'] for row in found]):.3f}",
                f"{100 * np.mean([row['iou_cable'] for row in found]):.1f}",
                f"{right} of {called}",
            ]
        )
    return Table(
        "Finding the cable first",
        ["Clouds", "points", "all", "kept", "true", "true points", "sizes", "error (mm)", "IoU (%)", "right at 90 %"],
        rows,
        f"Share of {results.runs[0]['clouds']} test clouds of 13 sizes whose size is told rightly: by a robust cylinder "
        "fit and the nearest size, fitted to all points, to those that the network keeps, to those that truly are the cable's; "
        "by the likeliest size, residuals of the true points taken for independent and normal; by adgcnn_fit. Its diameter's "
        f"median error, the cable's intersection over union; mean of {len(results.seeds)} seeds with its 95 % interval. Last, of "
        "the clouds that the network calls with 85 to 95 % certainty, all seeds together, those called rightly.",
        [("", 2), ("fit to points: accuracy", 3), ("likelihood", 1), ("adgcnn_fit", 4)],
    )


def arcs(results: Results) -> Table:
    """The same by the arc that is seen, beside what the true points allow."""
    rows = []
    for (dataset, n_points), found in _cells(results).items():
        for i, cell in enumerate(found[0]["by_arc"]):
            rows.append(
                [
                    dataset,
                    f"{n_points:,}",
                    f"{cell['from_deg']} to {cell['to_deg']}",
                    f"{cell['clouds']}",
                    f"{cell['likelihood']:.3f}",
                    estimate([row["by_arc"][i]["adgcnn_fit"] for row in found]).format(3),
                ]
            )
    return Table(
        "What the arc allows",
        ["Clouds", "points", "arc (degrees)", "clouds", "likeliest on true points", "adgcnn_fit"],
        rows,
        "Accuracy by the arc of the circumference that the true points cover.",
    )


KINDS = {"validation": "validation, which chose", "test": "test", "new": "new"}


def calibration(results: Results) -> Table:
    """Of the clouds called with 90 % certainty those called rightly, before and after one temperature."""
    rows = []
    for kind, told in KINDS.items():
        found = []
        for when in ("before", "after"):
            called, right = (
                sum(row[f"{kind}_{when}"][key] for row in results.runs) for key in ("called_90", "called_90_right")
            )
            share = wilson(right, called)
            errors = [row[f"{kind}_{when}"]["expected_calibration_error"] for row in results.runs]
            found += [
                f"{100 * share.value:.1f} ({100 * share.low:.1f} to {100 * share.high:.1f})",
                f"{np.mean(errors):.3f}",
            ]
        clouds = sum(each["clouds"] for each in results.runs[0][f"{kind}_before"]["bins"])
        rows.append([told, f"{clouds:,}", *found])
    temperatures = ", ".join(f"{row['temperature']:.2f}" for row in results.runs)
    return Table(
        "Right as often as sure",
        ["Clouds", "a seed", "right (%)", "error", "right (%)", "error"],
        rows,
        f"adgcnn_fit on `hard` clouds of 512 points, {len(results.runs)} seeds together: of the clouds called with 85 to 95 % "
        "certainty those called rightly, with the 95 % interval, and the expected calibration error over ten bins; before and "
        f"after the logits are divided by a temperature that validation clouds chose ({temperatures}).",
        [("", 2), ("before", 2), ("after", 2)],
    )
