"""`cablejax measure`: the cable in a scan, with its diameter and what is known about it."""

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from cablejax.batch.table import Column
from cablejax.cli import exports, folder, measure_input, scene, standards
from cablejax.cli.arguments import add_scan
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import rows, say
from cablejax.geometry.words import where
from cablejax.optional import require

SCHEMA = "measure-rows/1"
COLUMNS = (
    Column("diameter_mm", "number", "overall diameter"),
    Column("low_mm", "number", "lower end of its 95 % interval"),
    Column("high_mm", "number", "upper end of its 95 % interval"),
    Column("std_mm", "number", "its standard uncertainty"),
    Column("minimum_mm", "number", "least diameter"),
    Column("maximum_mm", "number", "greatest diameter"),
    Column("ovality", "number", "their difference over the mean diameter"),
    Column("length_mm", "number", "length of the axis within the scan"),
    Column("bend_radius_mm", "number", "radius of the tightest bend; empty where straight"),
    Column("arc_deg", "number", "circumference seen"),
    Column("noise_mm", "number", "standard deviation of the points about the surface"),
    Column("points", "whole", "points that the diameter rests on"),
    Column("reading_mm", "number", "reading after IEC 60811-203; of two, their mean"),
    Column("x_mm", "number", "middle of the axis, with `--all`"),
    Column("y_mm", "number", "middle of the axis, with `--all`"),
    Column("z_mm", "number", "middle of the axis, with `--all`"),
    Column("verdict", "text", "nominal size, with `--catalogue`"),
    Column("conformity", "text", "`pass`, `fail` or `undecided`, with `--tolerance`"),
)


HELP = "diameter, ovality, length and bend radius of the cable in a scan, with their uncertainty"
DESCRIPTION = "Find the cable in a scan and measure it. The diameter comes with a 95 %% interval and its budget."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_scan(parser)
    parser.add_argument(
        "--report", metavar="FILE.html", help="write a self-contained report; a folder for a folder of scans"
    )
    scene = parser.add_argument_group("scenes of several cables")
    scene.add_argument("--all", action="store_true", help="measure every cable of the scan, each with a number")
    scene.add_argument("--expect", type=int, metavar="N", help="with --all: say so where another number is found")
    scene.add_argument("--picture", metavar="FILE.png", help="with --all: draw the scan with the cables' numbers")
    add_options(parser)
    exports.add_arguments(parser)
    folder.add_arguments(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is known of cable and scanner, and how they are judged: as well of `report` and `gage`."""
    parser.add_argument("--catalogue", metavar="KV", help="tell the nominal size, by rated voltage U0/U: 8.7/15")
    parser.add_argument(
        "--tolerance",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="limits of the diameter in mm: pass, fail or undecided",
    )
    labels = parser.add_mutually_exclusive_group()
    labels.add_argument(
        "--labels",
        choices=("auto", "off"),
        help="auto: where the cable found has other things beside it, a network of the package labels the points, and where "
        "search and labels disagree both are told; off: the search alone (default: auto; with --all off)",
    )
    labels.add_argument(
        "--checkpoint",
        metavar="FOLDER",
        help="of a run of experiments.parts: its network labels the points, and the cable's alone are measured",
    )
    parser.add_argument(
        "--scanner",
        metavar="NAME|NUMBERS",
        help="a preset of the simulator (line-laser), or what is known at the cable's distance: "
        "range_std_mm=1.2,footprint_mm=1 (optional: incidence_power, lateral_std_mm)",
    )
    parser.add_argument(
        "--stations",
        type=int,
        metavar="N",
        help="scanner positions, if known: 1 for a single view, which needs no alignment",
    )
    limits = parser.add_argument_group("what is known of the cable, in mm and in the scan's coordinates")
    limits.add_argument(
        "--diameter", type=float, nargs=2, metavar=("LOW", "HIGH"), help="its diameter is between these"
    )
    limits.add_argument("--near", type=float, nargs=3, metavar=("X", "Y", "Z"), help="the cable nearest to this point")
    limits.add_argument(
        "--axis", type=float, nargs=3, metavar=("X", "Y", "Z"), help="it runs along this, within 20 degrees"
    )
    limits.add_argument(
        "--box",
        type=float,
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="look at no point outside this box",
    )
    parser.add_argument("--section", type=float, metavar="MM", help="distance between sections (default: D/4)")
    parser.add_argument("--registration-std", type=float, default=0.0, metavar="MM", help="of the stations' alignment")
    parser.add_argument(
        "--scale-std", type=float, default=0.0, metavar="RATIO", help="of the scanner's scale, 1e-4 say"
    )
    parser.add_argument(
        "--lens-std",
        type=float,
        metavar="K",
        help="of the radial distortion that a depth image may still hold (default: 0.1; 0 if it was rectified)",
    )
    parser.add_argument("--maker-std", type=float, default=0.0, metavar="MM", help="of makers' diameters about nominal")
    parser.add_argument("--seed", type=int, default=0, help="of the random samples in the search (default: 0)")


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Measure a scan, or every scan of a folder."""
    if options.all and options.labels == "auto":
        raise NoResultError("--labels auto: is for one cable, not for --all")
    for name in ("expect", "picture"):
        if not options.all and getattr(options, name) is not None:
            raise NoResultError(f"--{name}: is for --all")
    if Path(options.scan).is_dir() and options.command == "measure":
        if options.picture is not None:
            raise NoResultError("--picture: is for one scan, not for a folder; give --report")
        return folder.run_folder(options, _places(options))
    folder.refuse_options(options, *(("jsonl", "scheduler") if options.all else ()))
    return one(options)


def _places(options: argparse.Namespace) -> folder.Places:
    """Where the report and the exports of each scan go."""
    places = {}
    if (reports := options.report) is not None:
        require("jinja2", "plotly", "matplotlib", why="a report")
        places["report"] = lambda scan: Path(reports) / f"{scan.name}.html"
    if (exported := options.export) is not None:
        exports.check(options)
        places["export"] = lambda scan: Path(exported) / scan.name
    return places


def rows_of(result: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows of the cables in a folder's table."""
    if "cables" in result:
        return scene.rows_of(result)
    low, high = result["interval_mm"]
    same = {column.name: result.get(column.name) for column in COLUMNS}
    same["reading_mm"] = result["readings"]["mean_mm"]
    return [{**same, "low_mm": low, "high_mm": high, "warnings": " ".join(result.get("warnings", ()))}]


def one(options: argparse.Namespace) -> dict[str, Any]:
    """Read, measure, judge, write the report."""
    if options.all:
        return scene.run(options)
    measure_input.check_tolerance(options)
    measure_input.check_report(options, "jinja2", "plotly", "matplotlib")
    exports.check(options)
    scan, part, given = measure_input.read_labelled(options)
    from cablejax.measure import MeasureError

    say(options, f"measuring {len(scan.xyz_mm):,} points")
    try:
        result, part, candidates = measure_input.measured(options, scan, part, given)
    except MeasureError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    parts = None if part is None else dict(sorted(Counter(part.tolist()).items(), key=lambda pair: -pair[1]))
    if options.report is not None:
        from cablejax.report import measurement_page

        html = measurement_page(
            result,  # pyright: ignore[reportArgumentType] frozen, and the protocol's attributes could be set
            title=Path(options.scan).name,
            source=str(options.scan),
            xyz_mm=scan.xyz_mm,
            parts=parts,
        )
        measure_input.save_report(options, html)
    read, section_sizes = standards.read_and_sized(result, options.tolerance)
    exported = exports.write(options, scan, result, read, section_sizes)
    return {
        "file": str(scan.path),
        "file_unit": scan.unit,
        "dropped": scan.dropped,
        **result.to_dict(),
        **standards.as_json(read, section_sizes),
        "parts": parts,
        "candidates": candidates,
        "tolerance_mm": options.tolerance,
        "conformity": measure_input.conformity_of(options, result.diameter_mm, result.std_mm),
        "exported": exported,
    }


def _interval(interval: list[float] | None, digits: str = ".3f") -> str:
    return "" if interval is None else f"  (95 %: {interval[0]:{digits}} to {interval[1]:{digits}})"


def _line(row: dict[str, Any]) -> str:
    size = "" if row["verdict"] is None else f", {row['verdict']}"
    return f"{row['diameter_mm']:.3f} mm{_interval([row['low_mm'], row['high_mm']])}{size}"


def _stretch(one: dict[str, Any]) -> tuple[str, str]:
    """A stretch of constant or tapering diameter: where it is, and its diameter with the 95 % interval."""
    told = f"{one['first_mm']:.2f} mm{_interval(one['first_interval_mm'], '.2f')}"
    if one["kind"] == "tapering":
        told += f" to {one['last_mm']:.2f} mm{_interval(one['last_interval_mm'], '.2f')}"
    return f"  {where(one['from_mm'], one['to_mm'])} mm", told


def table(result: dict[str, Any]) -> str:
    """The result for reading: numbers, budget, nominal sizes, warnings."""
    if "rows" in result:
        return folder.table(result, _line)
    if "cables" in result:
        return scene.table(result)
    r = result
    bend = "straight within its uncertainty"
    if r["bend_radius_mm"] is not None:
        bend = f"{r['bend_radius_mm']:.0f} mm{_interval(r['bend_interval_mm'], '.0f')}"
        bend += f", {r['bend_radius_mm'] / r['diameter_mm']:.1f} diameters"
    pairs = [("diameter", f"{r['diameter_mm']:.3f} mm{_interval(r['interval_mm'])}"), *standards.lines(r)]
    if r["ovality"] is not None:
        across = f"{r['minimum_mm']:.3f} mm by {r['maximum_mm']:.3f} mm"
        pairs.append(("ovality", f"{100 * r['ovality']:.2f} % +- {196 * r['ovality_std']:.2f} %, {across}"))
    if r["free_section"] is not None:
        jaws = r["free_section"]["square_mm"]
        round_ = f"{r['free_section']['diameter_mm']:.3f} mm round by its perimeter"
        pairs.append(("free-form section", f"{jaws[0]:.3f} mm by {jaws[1]:.3f} mm between jaws, {round_}"))
    if r["form"] != "one diameter":
        pairs += [("along its length", r["form"]), *(_stretch(one) for one in r["stretches"])]
    pairs += [
        ("length", f"{r['length_mm']:.1f} mm"),
        ("bend radius", bend),
        ("least bend radius", ", ".join(f"{name} {judged}" for name, judged in r["bend_conformity"].items())),
        ("seen", f"{r['arc_deg']:.0f} degrees of the circumference, {r['points']:,} points"),
        ("noise", f"{r['noise_mm']:.3f} mm (standard deviation about the surface)"),
    ]
    if r["parts"] is not None:
        total = sum(r["parts"].values())
        pairs.append(("labelled", ", ".join(f"{name} {100 * n / total:.1f} %" for name, n in r["parts"].items())))
    if (both := r["candidates"]) is not None and both["labels_mm"] is not None:
        pairs.append(("candidates", f"search {both['search_mm']:.3f} mm, labels {both['labels_mm']:.3f} mm"))
    if r["verdict"] is not None:
        pairs.append(("nominal size", r["verdict"]))
    if r["conformity"] is not None:
        low, high = r["tolerance_mm"]
        pairs.insert(1, ("within tolerance", f"{r['conformity']} ({low:g} to {high:g} mm)"))
    for one in r["irregularities"]:
        pairs.append((one["kind"], f"at {where(one['from_mm'], one['to_mm'])} mm, {one['change_mm']:+.2f} mm"))
    parts = [f"{r['file']}", rows(pairs), "", "  uncertainty of the diameter (standard deviation)"]
    total = ("together", f"{r['std_mm']:.4f} mm")
    parts.append(rows([*((line["source"], f"{line['std_mm']:.4f} mm") for line in r["budget"]), total]))
    likely = [(name, f"{100 * p:.1f} %") for name, p in r["nominal"].items() if p >= 0.001]
    if likely:
        parts += ["", "  probability of the nominal sizes", rows(likely)]
    parts += ["", *(f"  note: {warning}" for warning in r["warnings"])] if r["warnings"] else []
    return "\n".join(parts)
