"""`cablejax gage`: how well repeated scans agree (AIAG MSA): repeatability, reproducibility, %GRR, categories."""

import argparse
import copy
import csv
import io
import re
from pathlib import Path
from typing import Any

from cablejax.cli import folder, measure
from cablejax.cli.arguments import UNITS, add_columns
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import check_output, rows, save_bytes
from cablejax.optional import require

PATTERN = "{part}_{operator}_{trial}"
PLAN = ("file", "part", "operator")
Cell = tuple[str, str]


HELP = "how well repeated scans agree: repeatability and reproducibility after AIAG MSA"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command: those of a study, and of `measure`."""
    parser.add_argument(
        "scan", metavar="folder", help="folder of scans: the same parts, each several times by each operator"
    )
    parser.add_argument(
        "--pattern", default=PATTERN, metavar="TEXT",
        help=f"how files are named, without ending; {{operator}} may be left out (default: {PATTERN})",
    )  # fmt: skip
    parser.add_argument("--plan", metavar="FILE.csv", help=f"in its place, a table with the columns {', '.join(PLAN)}")
    parser.add_argument("--chart", metavar="FILE.png", help="draw the study: .png, .svg or .pdf")
    parser.add_argument("--unit", choices=UNITS, help="unit of the files' coordinates")
    add_columns(parser)
    parser.set_defaults(all=False, expect=None, picture=None)
    measure.add_options(parser)
    folder.add_arguments(parser)


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Measure every scan, split the variation."""
    if not Path(options.scan).is_dir():
        raise NoResultError(f"{options.scan}: expected a folder of scans")
    if options.chart is not None:
        require("matplotlib", why="--chart")
        check_output(options.chart, (".png", ".svg", ".pdf"))
    place = _planned(options.plan) if options.plan is not None else _named(options.pattern)
    for_all = copy.copy(options)
    for_all.command, for_all.report, for_all.export = "measure", None, None
    measured = folder.run_folder(for_all)
    parts, operators, values = _cells(measured["rows"], place)
    from cablejax.measure.standards import gage_study

    width = None if options.tolerance is None else options.tolerance[1] - options.tolerance[0]
    try:
        study = gage_study(values, tolerance=width)
    except ValueError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    if options.chart is not None:
        _save_chart(options.chart, parts, operators, values, study)
    return {
        "folder": options.scan,
        "parts": parts,
        "operators": operators,
        "trials": values.shape[2],
        "unit": "mm",
        "diameters_mm": values.tolist(),
        **study._asdict(),
        "tolerance_mm": options.tolerance,
        "chart": options.chart,
    }


def _named(pattern: str) -> Any:
    """What finds part and operator in a file's name.

    Raises:
        NoResultError: If the pattern names no part and no trial, or something else.
    """
    fields = re.findall(r"{(.*?)}", pattern)
    if "part" not in fields or len(set(fields)) < len(fields) or not set(fields) <= {"part", "operator", "trial"}:
        raise NoResultError(f"--pattern {pattern}: expected {{part}} and at most {{operator}} and {{trial}}, each once")
    # Names may hold what stands between them, but for the last: "cable_25_anna_1".
    text = re.sub(r"\\{(part|operator|trial)\\}", r"(?P<\1>.+)", re.escape(pattern))

    def place(file: str) -> Cell:
        found = re.fullmatch(text, Path(file.removesuffix(".gz")).stem)
        if found is None:
            raise NoResultError(f"--pattern {pattern}: does not fit {file}; give another, or --plan")
        return found["part"], found.groupdict().get("operator") or "all"

    return place


def _planned(path: str) -> Any:
    """What looks part and operator up in a table.

    Raises:
        NoResultError: If it is no such table.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            lines = list(reader)
    except (OSError, UnicodeDecodeError) as error:
        raise NoResultError(
            f"--plan {path}: cannot be read ({getattr(error, 'strerror', None) or 'no UTF-8'})"
        ) from None
    missing = [name for name in PLAN if name not in (reader.fieldnames or ())]
    if missing:
        raise NoResultError(f"--plan {path}: expected the columns {', '.join(PLAN)}, {', '.join(missing)} missing")
    known = {line["file"]: (line["part"], line["operator"]) for line in lines}

    def place(file: str) -> Cell:
        if file not in known:
            raise NoResultError(f"--plan {path}: has no line for {file}")
        return known[file]

    return place


def _cells(found: list[dict[str, Any]], place: Any) -> tuple[list[str], list[str], Any]:
    """Parts, operators and `[parts, operators, trials]` diameters.

    Raises:
        NoResultError: If a scan has no one diameter, or the trials are not as many everywhere.
    """
    import numpy as np

    cells: dict[Cell, list[float]] = {}
    for row in found:
        if row["outcome"] != "result":
            raise NoResultError(
                f"{row['file']}: has no diameter: {row['error']}; move it out of the folder, or scan anew"
            )
        if row["cables"] != 1:
            raise NoResultError(f"{row['file']}: holds {row['cables']} cables; a study wants one")
        cells.setdefault(place(row["file"]), []).append(row["diameter_mm"])
    parts, operators = (sorted({cell[i] for cell in cells}) for i in (0, 1))
    counts = {(p, o): len(cells.get((p, o), ())) for p in parts for o in operators}
    most = max(counts.values())
    for (part, operator), count in counts.items():
        if count != most:
            raise NoResultError(f"part {part}, operator {operator}: {count} trials where others have {most}")
    return parts, operators, np.array([[cells[p, o] for o in operators] for p in parts])


def _save_chart(path: str, parts: list[str], operators: list[str], values: Any, study: Any) -> None:
    from cablejax.report.gage import gage_chart

    image = io.BytesIO()
    gage_chart(parts, operators, values, study).savefig(image, format=Path(path).suffix[1:].lower(), dpi=120)
    save_bytes(path, image.getvalue())


def table(result: dict[str, Any]) -> str:
    """The study for reading."""
    r = result
    total = r["total"]
    parts = [
        ("repeatability (EV)", r["repeatability"]), ("reproducibility (AV)", r["reproducibility"]),
        ("of which interaction", r["interaction"]), ("gage (GRR)", r["gage"]), ("parts (PV)", r["part"]), ("total (TV)", total),
    ]  # fmt: skip
    pairs = [(name, f"{value:.4f} mm  {100 * value / total:5.1f} % of TV") for name, value in parts]
    pairs.append(("distinct categories (ndc)", str(r["categories"])))
    if r["percent_tolerance"] is not None:
        pairs.append(("6 GRR of the tolerance", f"{r['percent_tolerance']:.1f} %"))
    pairs.append(("verdict (AIAG MSA)", f"{r['verdict']}, %GRR {r['percent_gage']:.1f} %"))
    counts = f"{len(r['parts'])} parts, {len(r['operators'])} operators, {r['trials']} trials; standard deviations"
    return "\n".join([r["folder"], f"  {counts}", rows(pairs)])
