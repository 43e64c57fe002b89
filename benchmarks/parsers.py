"""Read every file under $CABLEJAX_DATA/parsers, good and broken, and say what came out.

    CABLEJAX_DATA=... python -m benchmarks.parsers [--output results/benchmarks/parsers.json]

One row a file: its size, then points read, invalid returns dropped, colours and intensities, or the reason why it was
refused. Beside it stands the number of points that laspy, or pye57's header, gives without this project: the two must
agree, and a refusal must stand against an error or no points.
"""

import argparse
import os
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from benchmarks import record
from cablejax.io import PointFileError, read_points

POINT_FILES = (".las", ".laz", ".e57")


def row(path: Path, folder: Path) -> dict[str, Any]:
    """What reading one file gives."""
    result: dict[str, Any] = {"file": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size}
    start = time.perf_counter()
    try:
        scan = read_points(path, unit="m")
    except PointFileError as error:
        result |= {"points": None, "refused": error.reason}
    else:
        result |= {
            "points": len(scan.xyz_mm),
            "dropped": scan.dropped,
            "color": None if scan.color is None else str(scan.color.dtype),
            "intensity": scan.intensity is not None,
        }
    return result | {"seconds": round(time.perf_counter() - start, 3), "peer_points": peer_points(path)}


def peer_points(path: Path) -> int | str:
    """How many points the format's own library finds, or the kind of error it raises."""
    import laspy
    import pye57

    try:
        if path.suffix == ".e57":
            file = pye57.E57(str(path))
            return sum(file.get_header(index).point_count for index in range(file.scan_count))
        return len(laspy.read(str(path)).points)
    except Exception as error:  # noqa: BLE001 (whatever it is, it is the answer)
        return type(error).__name__


def agrees(result: dict[str, Any]) -> bool:
    """Whether ours and the peer's count are the same; a refusal stands against an error or no points."""
    peer = result["peer_points"]
    if result["points"] is None:
        return isinstance(peer, str) or peer == 0
    return peer == result["points"] + result["dropped"]


def main() -> None:
    """Print the table and write it with its provenance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("results/benchmarks/parsers.json"))
    options = parser.parse_args()
    folder = Path(os.environ.get("CABLEJAX_DATA", "")) / "parsers"
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for path in sorted(folder.rglob("*")):
            if path.suffix in POINT_FILES:
                rows.append(row(path, folder))
                print(
                    f"{rows[-1]['file'].split('/')[-1]:42} {rows[-1]['points'] or rows[-1].get('refused')}", flush=True
                )
    if not rows:
        sys.exit("no files found: set CABLEJAX_DATA to the folder that holds parsers/")
    apart = [result["file"] for result in rows if not agrees(result)]
    print(
        f"{len(rows)} files, {sum(r['points'] is not None for r in rows)} read, {len(apart)} differ from the peer: {apart}"
    )
    options.output.parent.mkdir(parents=True, exist_ok=True)
    record.write(options.output, {"files": record.table(rows), "disagreements": record.table(apart)})
    sys.exit(1 if apart else 0)


if __name__ == "__main__":
    main()
