"""Tables of the other benchmarks: denoising, the filter's defaults, the simulator, readers."""

from typing import Any

from experiments.analysis.benchmark import Benchmark
from experiments.analysis.results import NAMES
from experiments.display.table import Table


def denoise(results: Benchmark) -> Table:
    """Chamfer distance on PCNet's shapes, at three levels of noise."""
    rows = [
        [
            f"{100 * float(row['level']):g} % noise, {row['method']}",
            f"{row['all']:.3f}",
            f"{row['tuned']:.3f}",
            f"{row['held_out']:.3f}",
        ]
        for row in results.rows("rows")
    ]
    return Table(
        "Denoising PCNet's shapes: 10⁴ Chamfer distance",
        ["Noise, method", "all 10 shapes", "5 shapes tuned on", "5 others"],
        rows,
        "10,000 points a shape; the smaller the better. The filter has one setting for all levels, chosen on the first five "
        "shapes; the other methods had their neighbours chosen for each level on those shapes.",
    )


def cables(results: Benchmark) -> Table:
    """What the filter leaves of noise, and how it moves the diameter, for thick and thin cables."""
    rows = [
        [
            f"{row['diameter_mm']:g} mm cable, {row['noise_mm']:g} mm noise",
            f"{row['std_mm']:.4f}",
            f"{row['noise_mm'] / row['std_mm']:.1f}",
            f"{row['diameter_bias_mm']:+.4f}",
        ]
        for row in results.rows("rows")
    ]
    config = results.tables["rows"].config
    return Table(
        f"The adaptive filter of order {config['order']} with no parameter given",
        ["Cable and noise", "noise left (mm)", "reduction", "diameter bias (mm)"],
        rows,
        f"Half-cylinders of {config['points']:,} points, away from the cut edges. Noise of a fifth of the diameter (1 mm on "
        "5 mm) is beyond it.",
    )


def networks(results: Benchmark) -> Table:
    """Parameters, operations and speed of every network."""
    config = results.tables["networks"].config
    rows = [
        [
            NAMES.get(row["network"], row["network"]),
            f"{row['parameters'] / 1e6:.2f}",
            f"{row['flop'] / 1e9:.3f}",
            f"{1e3 * row['step_s']:.0f}",
            f"{config['clouds'] / row['inference_s']:.0f}",
            f"{row['first_step_s']:.0f}",
        ]
        for row in results.rows("networks")
    ]
    return Table(
        "What each network costs",
        [
            "Network",
            "million parameters",
            "GFLOP a cloud",
            "training step (ms)",
            "clouds a second",
            "first step after (s)",
        ],
        rows,
        f"Batches of {config['clouds']} clouds of {config['points']} points, {config['classes']} classes, on {results.machine}; "
        "operations as XLA counts them, bodies of loops once. Networks on points have no fit in their input but adgcnn_fit; "
        "those on images project the points first. The first step includes compiling.",
    )


def simulator(results: Benchmark) -> Table:
    """Training clouds that the simulator makes in a minute."""
    rows = [
        [
            f"{row['version']}, {row['points']:,} points",
            f"{row['clouds_per_minute']:,.0f}",
            f"{row['first_call_s']:.1f}",
        ]
        for row in results.rows("training_clouds")
    ]
    device = results.tables["training_clouds"].config["device"]
    return Table(
        "Simulated training clouds",
        ["Version, points a cloud", "clouds a minute", "first call (s)"],
        rows,
        f"On {device.upper()}. `standard` and `real-like` share the programs that `clean` and `hard` compiled.",
    )


def readers(results: Benchmark) -> Table:
    """Files of other projects' test suites, read here and by the peer for that format."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for row in results.rows("files"):
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
        f"Disagreements: {len(results.rows('disagreements'))}.",
    )


def damaged(results: Benchmark) -> Table:
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
        for row in results.rows("rows")
    ]
    return Table(
        "Randomly damaged files",
        ["Format", "tried", "refused", "read", "reader's process died", "failures"],
        rows,
        "Bits flipped, stretches cut, doubled or overwritten at random. Native readers run in a process of their own: where it "
        "dies the file is refused. A failure would be a crash of the program, an unworded error, or half a cloud.",
    )
