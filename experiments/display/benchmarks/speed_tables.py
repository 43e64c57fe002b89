"""Tables of the benchmarks that time: kernels beside other libraries, cleaning, registration."""

from collections.abc import Iterator
from typing import NamedTuple

from experiments.analysis.benchmark import Benchmark, BenchmarkTable
from experiments.display.table import Table

Found = dict[str, Benchmark]

TASKS = {
    "neighbors": "k nearest neighbours",
    "statistical removal": "statistical outlier removal",
    "features": "neighbours among features",
    "train_adgcnn_step": "ADGCNN, training step",
    "train_adgcnn_inference": "ADGCNN, inference",
    "casting": "simulator, casting beams",
    "clouds of noise-free points": "simulator, a batch of scans",
}
LIBRARIES = {
    "open3d": "Open3D",
    "top_k": "JAX, top_k",
    "open3d fine": "Open3D, fine mesh",
    "open3d coarse": "Open3D, coarse mesh",
    "scipy": "SciPy",
    "scikit-learn": "scikit-learn",
    "torch": "PyTorch, eager",
}
COUNTS = ("points", "clouds", "channels", "beams", "beams_each", "k")
CLEANING = {
    "statistical removal": "statistical removal alone",
    "open3d statistical": "statistical removal alone, Open3D",
    "removal + order 0": "removal and the paper's filter (order 0)",
    "removal + order 2": "removal and the filter of order 2",
}


class Race(NamedTuple):
    """One peer's time for one task beside ours.

    Attributes:
        task: What is done.
        work: How much of it: "53,135 points, k 20".
        peer: The library, or "cablejax".
        seconds: Median of the warm runs.
        quartiles: First and third of them.
        first: What the first call takes on top, where compiling shows.
        ours: Seconds of ours for the same task.
    """

    task: str
    work: str
    peer: str
    seconds: float
    quartiles: tuple[float, float]
    first: float
    ours: float


def races(found: Found) -> Iterator[Race]:
    """Every timing in the benchmarks, a peer at a time, ours first in each task."""
    for name, results in found.items():
        if name == "benchmarks/filters":  # stages of one path, not contenders; `cleaning` shows them
            continue
        for table in results.tables.values():
            if any("contender" in row for row in table.rows):
                yield from _races(table)


def _races(table: BenchmarkTable) -> Iterator[Race]:
    title, config, rows = table.title, table.config, table.rows
    work = ", ".join(
        f"k {config[key]}" if key == "k" else f"{config[key]:,} {key.replace('_', ' ')}"
        for key in COUNTS
        if key in config
    )
    ours = rows[0]["median_s"]
    for row in rows:
        low, high = row["quartiles_s"]
        peer = str(row["contender"])
        yield Race(
            task=TASKS.get(title, title),
            work=work,
            peer=LIBRARIES.get(peer, peer),
            seconds=row["median_s"],
            quartiles=(low, high),
            first=row["first_call_extra_s"],
            ours=ours,
        )


def speed(found: Found) -> Table | None:
    """Time of each kernel beside other libraries, and what its first call takes."""
    rows = [
        [
            f"{race.task}: {race.peer}",
            race.work,
            f"{1e3 * race.seconds:,.1f}",
            f"{1e3 * race.quartiles[0]:,.1f} to {1e3 * race.quartiles[1]:,.1f}",
            "" if race.seconds == race.ours else f"{race.ours / race.seconds:.2f}",
            f"{race.first:.2f}",
        ]
        for race in races(found)
    ]
    if not rows:
        return None
    return Table(
        "Time beside other libraries",
        ["Task and library", "work", "median (ms)", "quartiles (ms)", "ours / theirs", "first call (s)"],
        rows,
        f"Contenders take turns in one process on the same data; warm runs, {next(iter(found.values())).machine}. Below 1 in "
        "`ours / theirs` ours is the faster. First call: what it takes on top of a warm one, nearly all of it compiling; "
        "with JAX's persistent cache later processes load the program instead.",
    )


def cleaning(results: Benchmark) -> Table:
    """Time of outlier removal and of the adaptive filter after it."""
    rows, stages = [], {row["contender"]: row for row in results.rows("contenders")}
    for name, label in CLEANING.items():
        row = stages[name]
        low, high = row["quartiles_s"]
        times = f"{1e3 * low:,.0f} to {1e3 * high:,.0f}"
        rows.append([label, f"{1e3 * row['median_s']:,.0f}", times, f"{row['first_call_extra_s']:.1f}"])
    config = results.tables["contenders"].config
    return Table(
        "Cleaning a scan",
        ["What", "median (ms)", "quartiles (ms)", "first call (s)"],
        rows,
        f"{config['points']:,} points, k {config['k']}, {100 * config['stray_share']:g} % of them astray; {results.machine}. "
        f"Points on which the two removals differ: {config['differing']}.",
    )


def registration(found: Found) -> Table | None:
    """Registration beside Open3D's: time and error against the known motion."""
    if "benchmarks/registration" not in found:
        return None
    rows = [
        [
            f"{row['clouds']}, {row['method']}: {row['library']}",
            f"{row['points']:,}",
            f"{1e3 * row['seconds']:,.0f}",
            f"{row['over_open3d']:.2f}",
            f"{row['error_mm']:.2f}",
            f"{row['error_mrad']:.2f}",
            f"{row['first_call_s']:.1f}",
        ]
        for row in found["benchmarks/registration"].rows("rows")
    ]
    return Table(
        "Registration of two clouds",
        [
            "Clouds, method: library",
            "points",
            "median (ms)",
            "/ Open3D",
            "error (mm)",
            "error (mrad)",
            "first call (s)",
        ],
        rows,
        "Root mean square of the error against the known motion. The LiDAR pair is real, the cable stations are simulated.",
    )
