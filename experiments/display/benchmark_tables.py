"""Tables of the benchmarks: time beside other libraries, denoising, the simulator, readers."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from experiments.display.table import Table
from experiments.results import Results

Found = dict[str, Results]

TASKS = {
    "neighbors": "k nearest neighbours",
    "statistical removal": "statistical outlier removal",
    "filters": "outlier removal and adaptive filter",
    "train_adgcnn_step": "ADGCNN, training step",
    "train_adgcnn_inference": "ADGCNN, inference",
    "casting": "simulator, casting beams",
    "clouds of noise-free points": "simulator, a batch of scans",
}
LIBRARIES = {
    "open3d": "Open3D",
    "open3d statistical": "Open3D",
    "open3d fine": "Open3D, fine mesh",
    "open3d coarse": "Open3D, coarse mesh",
    "scipy": "SciPy",
    "scikit-learn": "scikit-learn",
    "torch": "PyTorch, eager",
}
COUNTS = ("points", "clouds", "beams", "beams_each", "k")


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
    for results in found.values():
        tables = [results.raw, *(value for value in results.raw.values() if isinstance(value, dict))]
        for table in tables:
            if "contenders" in table:
                yield from _races(table)


def _races(table: dict[str, Any]) -> Iterator[Race]:
    config, rows = table["config"], table["contenders"]
    work = ", ".join(
        f"k {config[key]}" if key == "k" else f"{config[key]:,} {key.replace('_', ' ')}"
        for key in COUNTS
        if key in config
    )
    ours = next(iter(rows.values()))["median_s"]
    for name, row in rows.items():
        low, high = row["quartiles_s"]
        task = TASKS.get(table["title"], table["title"])
        yield Race(task, work, LIBRARIES.get(name, name), row["median_s"], (low, high), row["first_call_extra_s"], ours)


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
        f"Contenders take turns in one process on the same data; warm runs, {_machine(next(iter(found.values())))}. Below 1 in "
        "`ours / theirs` ours is the faster. First call: what it takes on top of a warm one, nearly all of it compiling; "
        "with JAX's persistent cache later processes load the program instead.",
    )


def _machine(results: Results) -> str:
    cpu = results.raw["provenance"]["cpu"]
    return f"{cpu['model']}, {cpu['usable']} cores"


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
        for row in found["benchmarks/registration"].raw["rows"]
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


def denoise(results: Results) -> Table:
    """Chamfer distance on PCNet's shapes, at three levels of noise."""
    rows = [
        [
            f"{100 * float(row['level']):g} % noise, {row['method']}",
            f"{row['all']:.3f}",
            f"{row['tuned']:.3f}",
            f"{row['held_out']:.3f}",
        ]
        for row in results.raw["rows"]
    ]
    return Table(
        "Denoising PCNet's shapes: 10⁴ Chamfer distance",
        ["Noise, method", "all 10 shapes", "5 shapes tuned on", "5 others"],
        rows,
        "10,000 points a shape; the smaller the better. The filter has one setting for all levels, chosen on the first five "
        "shapes; the other methods had their neighbours chosen for each level on those shapes.",
    )


def cables(results: Results) -> Table:
    """What the filter leaves of noise, and how it moves the diameter, for thick and thin cables."""
    rows = [
        [
            f"{row['diameter_mm']:g} mm cable, {row['noise_mm']:g} mm noise",
            f"{row['std_mm']:.4f}",
            f"{row['noise_mm'] / row['std_mm']:.1f}",
            f"{row['diameter_bias_mm']:+.4f}",
        ]
        for row in results.raw["rows"]
    ]
    return Table(
        f"The adaptive filter of order {results.raw['order']} with no parameter given",
        ["Cable and noise", "noise left (mm)", "reduction", "diameter bias (mm)"],
        rows,
        f"Half-cylinders of {results.raw['points']:,} points, away from the cut edges. Noise of a fifth of the diameter (1 mm on "
        "5 mm) is beyond it.",
    )


def simulator(results: Results) -> Table:
    """Training clouds that the simulator makes in a minute."""
    rows = [
        [
            f"{row['version']}, {row['points']:,} points",
            f"{row['clouds_per_minute']:,.0f}",
            f"{row['first_call_s']:.1f}",
        ]
        for row in results.raw["training_clouds"]
    ]
    return Table(
        "Simulated training clouds",
        ["Version, points a cloud", "clouds a minute", "first call (s)"],
        rows,
        f"On {results.raw['device'].upper()}. `standard` and `real-like` share the programs that `clean` and `hard` compiled.",
    )


def readers(results: Results) -> Table:
    """Files of other projects' test suites, read here and by the peer for that format."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for row in results.raw["rows"]:
        kinds.setdefault(row["file"].rsplit(".", 1)[1].lower(), []).append(row)
    rows = []
    for kind, files in sorted(kinds.items()):
        read = [row for row in files if row["points"] is not None]
        rows.append(
            [
                kind.upper(),
                f"{len(files)}",
                f"{len(read)}",
                f"{sum(row['points'] == row['peer_points'] for row in read)}",
                f"{len(files) - len(read)}",
            ]
        )
    return Table(
        "Files of laspy's and libE57Format's test suites",
        ["Format", "files", "read", "same number of points as the peer", "refused, with the reason"],
        rows,
        f"Peers are laspy and pye57. Refused are files that are damaged or hold no point. "
        f"Disagreements: {len(results.raw['disagreements'])}.",
    )


def damaged(results: Results) -> Table:
    """Randomly damaged files: refused or read, never a crash."""
    rows = [
        [
            row["format"],
            f"{row['tried']:,}",
            f"{row['refused']:,}",
            f"{row['read']:,}",
            f"{row.get('died', 0):,}",
            f"{len(row['failures'])}",
        ]
        for row in results.raw["rows"]
    ]
    return Table(
        "Randomly damaged files",
        ["Format", "tried", "refused", "read", "reader's process died", "failures"],
        rows,
        "Bits flipped, stretches cut, doubled or overwritten at random. Native readers run in a process of their own: where it "
        "dies the file is refused. A failure would be a crash of the program, an unworded error, or half a cloud.",
    )
