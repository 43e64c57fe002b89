"""Read thousands of damaged files of every format: none may crash, hang, or come out as half a cloud.

    python -m benchmarks.fuzz_readers [--count 1000] [--output results/benchmarks/fuzz.json]

Prints one row a format: damaged files tried, read after all, refused with a `PointFileError`; then what must not be
there: other exceptions, deaths of the process, and truncated files read as a smaller cloud, but for one that lacks its
last point alone and is read with a warning. LAS, LAZ and E57 are read
by native libraries in a process of their own; where that process dies or has to be stopped, `read_points` reports it as
a `PointFileError`, and the row says how often. Every 40th file of theirs goes through `read_points` itself. A region of a
COPC file is read through `read_region` with a box about everything: the rows must then be all of them.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import record
from benchmarks.fuzz_files import base_files
from benchmarks.mutations import mutants, repair_e57
from cablejax.io import PointFileError, child, read_points, read_region

HERE = Path(__file__).resolve().parent
SECONDS = 20.0
MEMORY_BYTES = 4 * 2**30
END_TO_END = 40
# Text tables and OBJ have no count, so a file cut between two rows is a smaller whole one.
UNCOUNTED = ("xyz", "csv", "obj", "units.txt", "cells.csv", "index.xyz", "normals.xyz")
COLUMNS = {"index.xyz": "index,x,y,z"}
ONE_SHORT = "are there and were read"
REGION = "region.copc.laz"


class Worker:
    """A process that reads one file after the other and is started anew when it dies or hangs."""

    def __init__(self, command: list[str]):
        self.command = command
        self.process: subprocess.Popen[str] | None = None
        self.late_deaths = 0

    def ask(self, path: Path) -> dict[str, Any]:
        """How reading a file ends."""
        if self.process is None or self.process.poll() is not None:
            self.process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        timer = threading.Timer(2 * SECONDS + 60, self.process.kill)
        timer.start()
        try:
            self.process.stdin.write(f"{path}\n")
            self.process.stdin.flush()
        except BrokenPipeError:  # it answered for the last file and died while it cleaned up: a new one takes this file
            timer.cancel()
            self.close()
            self.late_deaths += 1
            return self.ask(path)
        line = self.process.stdout.readline()
        in_time = timer.is_alive()
        timer.cancel()
        if not (line and in_time):
            self.close()
        if line:
            return json.loads(line)
        return {"outcome": "died" if in_time else "hung"}

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            with contextlib.suppress(BrokenPipeError):  # what was not written when it died
                self.process.communicate()
            self.process = None


def answer_paths(lines: Iterator[str]) -> None:
    """The worker for formats that are parsed here: one line of JSON for each path."""
    for line in lines:
        print(json.dumps(judge(Path(line.rstrip("\n")))), flush=True)


def judge(path: Path) -> dict[str, Any]:
    """Read a file and say how it ended; of warnings only those that are meant for the user are allowed."""
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("error")
            warnings.simplefilter("always", UserWarning)
            xyz, dropped = _read_region(path) if path.name.endswith(REGION) else _read_points(path)
    except PointFileError as error:
        return {"outcome": "refused", "error": error.reason}
    except Exception as error:  # noqa: BLE001 (that is what is looked for)
        return {"outcome": "wrong exception", "error": repr(error)}
    good = len(xyz) > 0 and bool(np.isfinite(xyz).all())
    notes = [str(warning.message) for warning in said]
    return {"outcome": "read" if good else "bad cloud", "points": len(xyz), "dropped": dropped, "notes": notes}


def _read_points(path: Path) -> tuple[np.ndarray, int]:
    columns = next((names for name, names in COLUMNS.items() if path.name.endswith(name)), None)
    scan = read_points(path, unit="m", columns=columns, time_limit_s=SECONDS)
    return scan.xyz_mm, scan.dropped


def _read_region(path: Path) -> tuple[np.ndarray, int]:
    everything = np.full(3, np.inf)
    row, xyz = read_region(path, -everything, everything, unit="m", time_limit_s=SECONDS)
    return (xyz if np.array_equal(row, np.arange(len(row))) else xyz[:0]), 0


def fuzz(name: str, base: Path, count: int, seed: int, folder: Path) -> dict[str, Any]:
    """Try `count` damaged copies of a file; a row of the table."""
    kind = None if name == REGION else {"las": "las", "laz": "las", "e57": "e57"}.get(name.rsplit(".", 1)[-1])
    here = [sys.executable, "-W", "error", "-m", "benchmarks.fuzz_readers", "--worker"]
    native = [sys.executable, "-P", str(HERE / "fuzz_native.py"), str(kind), child.__file__, str(folder)]
    worker = Worker(here if kind is None else [*native, str(SECONDS), str(MEMORY_BYTES)])
    whole, outcomes, failures = judge(base)["points"], Counter(), []
    path = folder / f"damaged.{name}"
    repair = repair_e57 if kind == "e57" else None
    for index, (damage, content) in enumerate(mutants(base.read_bytes(), count, seed, repair=repair)):
        path.write_bytes(content)
        results = [worker.ask(path)]
        if kind is not None and index % END_TO_END == 0:
            results.append(judge(path))
            outcomes["end to end"] += 1
        for result in results:
            short = any(ONE_SHORT in note for note in result.get("notes", []))
            least = whole - 1 if short else whole
            cut = damage == "truncate" and name not in UNCOUNTED and result.get("points", whole) < least
            outcome = "half read" if cut and result["outcome"] == "read" else result["outcome"]
            outcomes[outcome] += result is results[0]
            outcomes["read with a warning"] += result is results[0] and outcome == "read" and bool(result.get("notes"))
            contained = kind is not None and outcome in ("died", "stopped") and result is results[0]
            if outcome not in ("read", "refused") and not contained:
                failures.append({"index": index, "damage": damage, **result, "outcome": outcome})
    worker.close()
    return {
        "format": name,
        "tried": count,
        "seed": seed,
        **outcomes,
        "late deaths": worker.late_deaths,
        "failures": failures,
    }


def main() -> None:
    """Fuzz every format, print the table, write it with its provenance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000, help="damaged files a format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--formats", nargs="*", help="only these")
    parser.add_argument("--output", type=Path, default=Path("results/benchmarks/fuzz.json"))
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        answer_paths(sys.stdin)
        return
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for label, base in base_files(folder).items():
            if not options.formats or label in options.formats:
                rows.append(fuzz(label, base, options.count, options.seed, folder))
                print(json.dumps(rows[-1]), flush=True)
    failures = sum(len(row["failures"]) for row in rows)
    print(f"{sum(row['tried'] for row in rows):,} damaged files, {failures} failures")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    record.write(options.output, {"rows": record.table(rows)}, seeds=[options.seed])
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
