"""What the results come to in three rows, each with the file that it is read from."""

from pathlib import Path

from experiments.analysis.benchmark import Benchmark
from experiments.analysis.results import Results
from experiments.display.table import Table


def headline_table(folder: Path) -> Table | None:
    """Filter, network and measurement in a row each; None where one of their files is missing."""
    filtered, network = (Results.read(folder, name) for name in ("table2_3_deviation", "standard_adgcnn"))
    simulated, real = (Benchmark.read(folder / "benchmarks", name) for name in ("coverage", "real"))
    if filtered is None or network is None or simulated is None or real is None:
        return None
    rows = [
        ["Filter, eqs. (2)-(8)", _filter(filtered), _files("table2_3_deviation")],
        ["Network, ADGCNN", _network(network), _files("standard_adgcnn")],
        ["Measured diameter", _measured(simulated, real), _files("benchmarks/coverage", "benchmarks/real")],
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


def _measured(simulated: Benchmark, real: Benchmark) -> str:
    scans = next(row for row in simulated.rows("summary") if row["by"] == "all")
    graded = next(row for row in real.rows("summary") if row["grade"] == "A, B, C")
    given = scans["scans"] - scans["refused"]
    return (
        f"the 95 % interval holds the truth in {round(scans['coverage'] * given)} of {given} simulated scans "
        f"({scans['refused']} more were refused), and in {graded['holds']} of {graded['holds'] + graded['misses']} real ones "
        f"of known size ({graded['refused']} refused; no cables)"
    )
