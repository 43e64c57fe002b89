"""Time reading a cloud of the paper's size in every format, beside Open3D and laspy in the same run.

    python -m benchmarks.read_points --rounds 7 --output read_points.json

53,135 points with colour and intensity. Medians over rounds that take turns; the ratio is ours over the peer's. laspy
runs in this process, ours starts a process for LAS and LAZ, which is most of its time.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import record
from cablejax.io import import_open3d, read_points, write_points

POINTS = 53_135
ENDINGS = ("ply", "pcd", "xyz", "csv", "las", "laz")


def peer(ending: str) -> tuple[str, Callable[[str], int]] | None:
    """Another library's reader of a format, which returns the number of points."""
    if ending in ("ply", "pcd"):
        open3d = import_open3d()
        return "open3d", lambda path: len(open3d.io.read_point_cloud(path).points)
    if ending in ("las", "laz"):
        import laspy

        return "laspy", lambda path: len(laspy.read(path).xyz)
    return None


def seconds(call: Callable[[], Any]) -> float:
    """How long a call takes."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def row(path: Path, rounds: int) -> dict[str, Any]:
    """Medians of reading one file, ours and the peer's in turns."""
    other = peer(path.suffix[1:])
    ours, theirs = [], []
    for _ in range(rounds):
        ours.append(seconds(lambda: read_points(path)))
        if other is not None:
            theirs.append(seconds(lambda: other[1](str(path))))
    result: dict[str, Any] = {"format": path.suffix[1:], "seconds": float(np.median(ours)), "peer": None}
    if other is not None:
        assert other[1](str(path)) == POINTS
        median = float(np.median(theirs))
        result |= {"peer": other[0], "peer_seconds": median, "ratio": result["seconds"] / median}
    return result


def main() -> None:
    """Print the table and write it with its provenance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--output", type=Path, help="write the rows here as JSON")
    options = parser.parse_args()
    open3d_import = seconds(import_open3d)
    rng = np.random.default_rng(0)
    cloud = {
        "xyz_mm": rng.normal(scale=20.0, size=(POINTS, 3)),
        "color": rng.integers(0, 256, (POINTS, 3)).astype(np.uint8),
        "intensity": rng.random(POINTS).astype(np.float32),
    }
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for ending in ENDINGS:
            path = Path(folder, f"scan.{ending}")
            write_points(path, **cloud)
            rows.append(row(path, options.rounds))
            print(
                "  ".join(
                    f"{key} {value:.3g}" if isinstance(value, float) else str(value) for key, value in rows[-1].items()
                )
            )
    print(f"importing open3d took {open3d_import:.2f} s")
    if options.output is not None:
        config = {"points": POINTS, "rounds": options.rounds, "open3d_import_seconds": open3d_import}
        record.write(options.output, {"rows": record.table(rows, config=config)}, seeds=[0], config=config)


if __name__ == "__main__":
    main()
