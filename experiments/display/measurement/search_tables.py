"""Tables of the search: cylinders of CAD models, and cluttered scenes with several seeds."""

from experiments.analysis.benchmark import Benchmark
from experiments.display.table import Table

VERDICTS = {
    "one": "the same from every seed",
    "in part": "the same from some, refused by others",
    "says so": "different, with a warning that the searches disagree",
    "refused": "refused by all",
    "differ": "different, without a warning",
}


def cad_cylinders(results: Benchmark) -> Table:
    """What the whole search says of the cylinders of Fit4CAD."""
    rows = [
        [
            f"{row['kind']}, noise of {100 * row['noise']:g} % of the radius",
            *(str(row[name]) for name in ("cylinders", "measured", "wrong", "refused")),
            f"{row['median_percent']:.3f}" if "median_percent" in row else "",
            f"{row['p90_percent']:.3f}" if "p90_percent" in row else "",
        ]
        for row in results.rows("summary")
        if row["cylinders"]
    ]
    return Table(
        "Cylinders of CAD models",
        [
            "Cylinders",
            "number",
            "measured",
            "off by more than 5 %",
            "refused",
            "median error (%)",
            "90th percentile (%)",
        ],
        rows,
        "The points of each cylinder of Fit4CAD with 50 points or more, of any length, through search and fit.",
    )


def clutter(results: Benchmark) -> Table:
    """How often the answer to a cluttered scene depends on the random samples of the search."""
    scenes = results.rows("scenes")
    kinds = [kind for kind in ("simulated", "real") if any(row["kind"] == kind for row in scenes)]
    rows = [
        [told, *(str(sum(row["kind"] == kind and row["verdict"] == name for row in scenes)) for kind in kinds)]
        for name, told in VERDICTS.items()
    ]
    seeds = len({row["seed"] for row in results.rows("answers")})
    return Table(
        "Cluttered scenes",
        ["The answer is", *(f"{kind} scenes" for kind in kinds)],
        rows,
        f"Each scene measured with {seeds} seeds of the search's random samples.",
    )
