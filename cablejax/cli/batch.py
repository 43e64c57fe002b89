"""A folder of scans measured one by one, with one CSV: a row a scan, its numbers or the reason why there are none."""

import argparse
import copy
import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cablejax.cli.main import NoResultError
from cablejax.cli.scans import check_output, rows, say
from cablejax.optional import require

READABLE = (".ply", ".pcd", ".xyz", ".txt", ".csv", ".pts", ".ptx", ".obj", ".las", ".laz", ".e57", ".gz")
COLUMNS: tuple[str, ...] = (
    "file", "diameter_mm", "low_mm", "high_mm", "std_mm", "minimum_mm", "maximum_mm", "ovality", "length_mm",
    "bend_radius_mm", "arc_deg", "noise_mm", "points", "verdict", "conformity", "error",
)  # fmt: skip


def run_folder(options: argparse.Namespace, measure_one: Callable[[argparse.Namespace], dict]) -> dict[str, Any]:
    """Measure every point file of the folder `options.scan`, in the order of their names.

    Raises:
        NoResultError: If the folder holds no point file, or none of them gives a result.
    """
    folder = Path(options.scan)
    if options.csv is not None:
        check_output(options.csv, (".csv",))
    files = sorted(path for path in folder.iterdir() if path.is_file() and path.suffix.lower() in READABLE)
    files = [path for path in files if options.csv is None or path.resolve() != Path(options.csv).resolve()]
    if not files:
        raise NoResultError(f"{folder}: is a folder without point files ({', '.join(READABLE)})")
    if options.report is not None:
        require("jinja2", "plotly", "matplotlib", why="a report")
        Path(options.report).mkdir(parents=True, exist_ok=True)
    done = []
    for number, path in enumerate(files, 1):
        say(options, f"{number} of {len(files)}: {path.name}")
        one = copy.copy(options)
        one.scan = str(path)
        one.report = None if options.report is None else str(Path(options.report) / f"{path.name}.html")
        try:
            done.append(measure_one(one))
        except NoResultError as error:
            done.append({"file": str(path), "error": str(error)})
    if options.csv is not None:
        _write(options.csv, done)
    if all("error" in one for one in done):
        raise NoResultError(f"{folder}: none of {len(done)} files gave a result; the first: {done[0]['error']}")
    return {"folder": str(folder), "csv": options.csv, "scans": done}


def _write(path: str, done: list[dict[str, Any]]) -> None:
    with Path(path).open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore", restval="")
        writer.writeheader()
        for one in done:
            low, high = one.get("interval_mm", ("", ""))
            writer.writerow({**one, "low_mm": low, "high_mm": high})


def table(result: dict[str, Any]) -> str:
    """A line a scan."""
    pairs = []
    for one in result["scans"]:
        name = Path(one["file"]).name
        if "error" in one:
            pairs.append((name, "no result: " + one["error"].removeprefix(f"{one['file']}: ")))
            continue
        low, high = one["interval_mm"]
        size = "" if one["verdict"] is None else f", {one['verdict']}"
        pairs.append((name, f"{one['diameter_mm']:.3f} mm  (95 %: {low:.3f} to {high:.3f}){size}"))
    return "\n".join([f"{result['folder']}", rows(pairs)])
