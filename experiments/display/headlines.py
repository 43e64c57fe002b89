"""What the results come to in three rows, each with the file that it is read from."""

from pathlib import Path

from experiments.analysis.results import Results
from experiments.display.table import Table

NEEDED = ("table2_3_deviation", "standard_adgcnn", "benchmarks/coverage", "benchmarks/real")


def headline_table(folder: Path) -> Table | None:
    """Filter, network and measurement in a row each; None where one of their files is missing."""
    found = {name: results for name in NEEDED if (results := Results.read(folder, name)) is not None}
    if len(found) < len(NEEDED):
        return None
    rows = [
        ["Filter, eqs. (2)-(8)", _filter(found["table2_3_deviation"]), _files("table2_3_deviation")],
        ["Network, ADGCNN", _network(found["standard_adgcnn"]), _files("standard_adgcnn")],
        ["Measured diameter", _measured(found), _files("benchmarks/coverage", "benchmarks/real")],
    ]
    return Table("Three rows", ["What", "Result", "File"], rows, "")


def _files(*names: str) -> str:
    return ", ".join(f"`results/{name}.json`" for name in names)


def _filter(results: Results) -> str:
    before = results.mean("before.std_mm", filter__order=0, noise__snr_db=60).mean
    told = []
    for order in (0, 2):
        cell = {"filter__order": order, "noise__snr_db": 60}
        after, bias = results.mean("after.std_mm", **cell).mean, results.mean("diameter_bias_mm", **cell).mean
        told.append(f"{after:.3f} mm, the diameter off by {bias:+.3f} mm")
    return (
        f"noise of 60 dB: a scatter of {before:.3f} mm becomes, with the paper's weighted mean, {told[0]}; "
        f"with a quadric on the same weights {told[1]}"
    )


def _network(results: Results) -> str:
    sizes = len(results.config("dataset.sizes_mm2"))
    return (
        f"{results.mean('test_overall').format(3)} of the clouds of {sizes} simulated sizes, {len(results.seeds)} seeds; "
        f"a cylinder fit and the nearest size, with no network, {results.mean('baseline_overall').mean:.3f}"
    )


def _measured(found: dict[str, Results]) -> str:
    simulated = next(row for row in found["benchmarks/coverage"].raw["table"] if row["by"] == "all")
    given = simulated["scans"] - simulated["refused"]
    real = next(row for row in found["benchmarks/real"].raw["table"] if row["grade"] == "A, B, C")
    return (
        f"the 95 % interval holds the truth in {round(simulated['coverage'] * given)} of {given} simulated scans "
        f"({simulated['refused']} more were refused), and in {real['holds']} of {real['holds'] + real['misses']} real ones "
        f"of known size ({real['refused']} refused; no cables)"
    )
