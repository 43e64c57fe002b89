"""A folder of scans measured one by one, with one CSV: a row a scan, its numbers or the reason why there are none."""

import argparse
import copy
import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cablejax.cli.main import NoResultError
from cablejax.cli.scans import check_output, make_folder, rows, say
from cablejax.optional import require

COLUMNS: tuple[str, ...] = (
    "file", "diameter_mm", "low_mm", "high_mm", "std_mm", "minimum_mm", "maximum_mm", "ovality", "length_mm",
    "bend_radius_mm", "arc_deg", "noise_mm", "points", "verdict", "conformity", "error",
)  # fmt: skip


def run_folder(options: argparse.Namespace, measure_one: Callable[[argparse.Namespace], dict]) -> dict[str, Any]:
    """Measure every point file of the folder `options.scan`, in the order of their names.

    A scan that fails, for whatever reason, is a row with that reason; the CSV holds every row as soon as it is known.

    Raises:
        NoResultError: If the folder holds no point file, none of them gives a result, or the CSV cannot be written.
    """
    folder = Path(options.scan)
    if options.csv is not None:
        check_output(options.csv, (".csv",))
    files = sorted(path for path in folder.iterdir() if _is_scan(path))
    files = [path for path in files if options.csv is None or path.resolve() != Path(options.csv).resolve()]
    if not files:
        from cablejax.io import READABLE

        raise NoResultError(f"{folder}: is a folder without point files ({', '.join(READABLE)}, each also with .gz)")
    if options.report is not None:
        require("jinja2", "plotly", "matplotlib", why="a report")
        make_folder(Path(options.report))
    done = []
    with _table_of(options.csv) as add:
        for number, path in enumerate(files, 1):
            say(options, f"{number} of {len(files)}: {path.name}")
            one = copy.copy(options)
            one.scan = str(path)
            one.report = None if options.report is None else str(Path(options.report) / f"{path.name}.html")
            done.append(_row(one, measure_one))
            add(done[-1])
    if all("error" in one for one in done):
        raise NoResultError(f"{folder}: none of {len(done)} files gave a result; the first: {done[0]['error']}")
    return {"folder": str(folder), "csv": options.csv, "scans": done}


def _is_scan(path: Path) -> bool:
    """Whether a file is taken for a scan: by its ending, unless it is hidden or a table that this command wrote."""
    from cablejax.io import READABLE

    endings = [ending.lower() for ending in path.suffixes]
    packed = endings[-1:] == [".gz"]
    ending = endings[-2:-1] if packed else endings[-1:]
    known = not ending if packed and len(endings) == 1 else bool(ending) and ending[0] in READABLE
    return known and not path.name.startswith(".") and path.is_file() and not _is_result(path)


def _is_result(path: Path) -> bool:
    """Whether a file is the CSV of an earlier run."""
    if path.suffix.lower() != ".csv":
        return False
    try:
        with path.open("rb") as file:
            return file.readline().strip() == ",".join(COLUMNS).encode()
    except OSError:
        return False


def _row(options: argparse.Namespace, measure_one: Callable[[argparse.Namespace], dict]) -> dict[str, Any]:
    """The result of a scan, or why there is none."""
    try:
        return measure_one(options)
    except NoResultError as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 (a defect met in one scan must not cost the others)
        reason = f"{options.scan}: a defect of this program, please report it: {type(error).__name__}: {error}"
        say(options, reason)
    return {"file": options.scan, "error": reason}


@contextmanager
def _table_of(path: str | None) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Rows appended to a CSV one by one, each on its way to the disk at once; nowhere without a path."""
    if path is None:
        yield lambda one: None
        return
    try:
        # File names may be no text: what UTF-8 cannot say is escaped.
        with Path(path).open("w", newline="", encoding="utf-8", errors="backslashreplace") as stream:
            writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore", restval="")
            writer.writeheader()

            def add(one: dict[str, Any]) -> None:
                low, high = one.get("interval_mm", ("", ""))
                writer.writerow({**one, "low_mm": low, "high_mm": high})
                stream.flush()

            yield add
    except OSError as error:
        raise NoResultError(f"{path}: cannot be written ({error.strerror})") from None


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
