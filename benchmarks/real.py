"""Real scans of round things of known size: which intervals hold, what is refused, and where a cable is seen that is none.

    CABLEJAX_DATA=... python -m benchmarks.real --out results/benchmarks/real.json

Every scan of `$CABLEJAX_DATA/real` is measured in a process of its own with a time limit. `truth.csv` there gives the truth
and its grade: A published and confirmed on a mesh, B from CAD or the part's name, C an independent fit or common sense, R
repeatability alone. With `--stations 1` each scan is told to be a single view, as all are but the trees' (`tb_*`), whose
laser walked round them. "34.4 or 37.0" is a stepped thing: one of the two must lie in the interval. "no cable" must be refused.
With `--labels` each is measured as `cablejax measure` does by default, with the labels of the package's network where other
things lie beside what the search finds; the row then also holds both candidates and the verdict on the search's.
Each scan's row goes to a file of lines beside the result, and a run that was stopped goes on from there.
"""

import argparse
import csv
import json
import os
import time
from fnmatch import fnmatch
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmarks import record

if TYPE_CHECKING:
    from cablejax.measure import PointLabels

LIMIT_S = 120.0
GRADES = ("A", "B", "C", "R", "")
ANSWERS = (
    "diameter_mm",
    "form",
    "std_mm",
    "interval_mm",
    "arc_deg",
    "noise_mm",
    "length_mm",
    "bend_radius_mm",
    "points",
)


def truths(folder: Path) -> list[dict[str, Any]]:
    """The scans with their grades and what is true of them: diameters, "no cable", or "" where nothing is known."""
    with (folder / "truth.csv").open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    return [
        {"scan": line["scan"], "grade": line["grade"], "truth": line["truth_mm"], "from": line["truth_from"]}
        for line in lines
    ]


def verdict(truth: str, row: dict[str, Any]) -> str:
    """What a measurement or its refusal is worth.

    Example:
        >>> verdict("34.4 or 37.0", {"interval_mm": [36.0, 38.0]})
        'holds'
        >>> verdict("no cable", {"interval_mm": [36.0, 38.0]})
        'false cable'
    """
    if "failed" in row:
        return "failed"
    if "refused" in row:
        return "rightly refused" if truth == "no cable" else "refused"
    if truth == "no cable":
        return "false cable"
    if not truth:
        return "measured"
    low, high = row["interval_mm"]
    return "holds" if any(low <= float(one) <= high for one in truth.split(" or ")) else "misses"


class Way(NamedTuple):
    """How scans are measured.

    Attributes:
        seed: Of the search.
        stations: What the measurement is told.
        labels: Whether a network labels the points.
    """

    seed: int
    stations: int | None
    labels: bool


def measured(path: Path, way: Way) -> dict[str, Any]:
    """The answer to one scan, in millimetres as the file holds it."""
    from cablejax.io import read_points
    from cablejax.measure import MeasureError, MeasureSettings, measure_cable, measure_labelled

    xyz = read_points(path, unit="mm").xyz_mm
    settings = MeasureSettings(seed=way.seed, stations=way.stations)
    start, candidates = time.perf_counter(), {}
    try:
        if way.labels:
            found = measure_labelled(xyz, lambda: labelled(xyz), settings=settings)
            by_labels = None if found.by_labels is None else list(found.by_labels.interval_mm)
            candidates = {
                "taken": found.taken,
                "by_search": list(found.by_search.interval_mm),
                "by_labels": by_labels,
            }
            result = found.result.to_dict()
        else:
            result = measure_cable(xyz, settings=settings).to_dict()
    except MeasureError as error:
        return {"refused": str(error), "seconds": time.perf_counter() - start}
    row = {name: result[name] for name in ANSWERS} | candidates
    row |= {"budget": {line["source"]: line["std_mm"] for line in result["budget"]}, "warnings": result["warnings"]}
    return {**row, "seconds": time.perf_counter() - start}


def labelled(xyz: np.ndarray) -> "PointLabels":
    """What the labeller of the package says of a scan."""
    from cablejax.measure import PointLabels
    from cablejax.nets import label_parts, load_pretrained

    network, card = load_pretrained("parts")
    clouds, parts = card["clouds"], card["classes"]
    part = label_parts(network, xyz, n_points=clouds["n_points"], ball_mm=clouds["ball_mm"]).part
    low, high = clouds["diameter_mm"]
    return PointLabels(part == parts.index("cable"), part == parts.index("accessory"), (low, high))


def _serve(pipe: Connection, way: Way) -> None:
    """Answer paths with rows until the pipe is closed; what is no refusal is told and not raised."""
    while True:
        try:
            path = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(measured(path, way))
        except (ArithmeticError, LookupError, MemoryError, RuntimeError, TypeError, ValueError) as error:
            # A crash is a result of this benchmark; what is none of these ends the process, which shows as well.
            pipe.send({"failed": f"{type(error).__name__}: {error}"})


class Worker:
    """A process that measures scan after scan, and is replaced by another where one takes too long."""

    def __init__(self, way: Way, *, limit_s: float) -> None:
        self.way, self.limit_s = way, limit_s
        self._start()

    def _start(self) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.way), daemon=True)
        self.process.start()
        theirs.close()

    def measure(self, path: Path) -> dict[str, Any]:
        """The row of one scan; one that says so where the limit passed or the process died."""
        self.pipe.send(path)
        try:
            if self.pipe.poll(self.limit_s):
                return self.pipe.recv()
            why = f"no answer within {self.limit_s:g} s"
        except EOFError:
            why = "the process died"
        self.process.kill()
        self.process.join()
        self._start()
        return {"failed": why}


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How many of each verdict, by grade, and all with a truth that a diameter can be held against."""
    out = []
    for grade in (*GRADES, "A, B, C"):
        part = [row for row in rows if row["grade"] and row["grade"] in grade] if grade else []
        part = [row for row in rows if row["grade"] == ""] if grade == "" else part
        verdicts = [row["verdict"] for row in part]
        names = ("holds", "misses", "refused", "false cable", "rightly refused", "measured", "failed")
        counts = {name: verdicts.count(name) for name in names}
        tried = counts["holds"] + counts["misses"]
        held = counts["holds"] / tried if tried else None
        out.append({"grade": grade or "no truth", "scans": len(part), **counts, "share_held": held})
    return out


def gather(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure every scan whose row is not yet in the file of lines."""
    folder = Path(os.environ.get("CABLEJAX_DATA", "../shared/data")) / "real"
    if not (folder / "truth.csv").is_file():
        raise SystemExit(f"{folder}: holds no truth.csv; CABLEJAX_DATA names the folder that real/ lies in")
    lines = Path(options.out).with_suffix(".jsonl") if options.out else None
    way = Way(options.seed, options.stations, options.labels)
    run = {"limit_s": options.limit, **way._asdict()}
    done: dict[str, dict[str, Any]] = {}
    if lines is not None and lines.is_file():
        head, *kept = [json.loads(line) for line in lines.read_text().splitlines()]
        if head != run:
            raise SystemExit(f"{lines}: holds scans of another run, {head}; this one is {run}")
        done = {row["scan"]: row for row in kept}
    elif lines is not None:
        lines.parent.mkdir(parents=True, exist_ok=True)
        lines.write_text(json.dumps(run) + "\n")
    worker, rows = Worker(way, limit_s=options.limit), []
    for one in truths(folder):
        if not any(fnmatch(one["scan"], pattern) for pattern in options.only.split(",")):
            continue
        if one["scan"] in done:
            rows.append(done[one["scan"]])
            continue
        row = {**one, **worker.measure(folder / f"{one['scan']}.ply")}
        rows.append({**row, "verdict": verdict(one["truth"], row)})
        if "by_search" in row:
            rows[-1]["verdict_of_search"] = verdict(one["truth"], {"interval_mm": row["by_search"]})
        print(_line(rows[-1]), flush=True)
        if lines is not None:
            with lines.open("a") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
    return rows


def _line(row: dict[str, Any]) -> str:
    told = f"{row.get('refused', row.get('failed', '')):.90s}"
    if "diameter_mm" in row:
        low, high = row["interval_mm"]
        told = f"{row['diameter_mm']:8.2f} [{low:.2f}, {high:.2f}], {row['arc_deg']:.0f} degrees, {row['length_mm']:.0f} mm long"
    head = f"{row['scan']:24s} {row['grade']:1s} {row['truth']:>12s}"
    return f"{head} {row['verdict']:>15s} {row.get('seconds', 0):5.1f} s  {told}"


def main() -> None:
    """Measure, print, and write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="*", help="patterns of scans' names, between commas")
    parser.add_argument("--seed", type=int, default=0, help="of the search")
    parser.add_argument("--stations", type=int, help="what each measurement is told: 1 for single views, as most are")
    parser.add_argument("--labels", action="store_true", help="with a network's labels, as `cablejax measure` does")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds for each scan")
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    rows = gather(options)
    for line in summary(rows):
        print(
            "  ".join(
                f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in line.items()
            )
        )
    if options.out:
        config = {
            "limit_s": options.limit,
            "only": options.only,
            "stations": options.stations,
            "labels": options.labels,
        }
        found = {"summary": record.table(summary(rows), config=config), "scans": record.table(rows)}
        record.write(options.out, found, seeds=[options.seed], config=config)


if __name__ == "__main__":
    main()
