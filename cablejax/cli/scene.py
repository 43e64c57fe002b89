"""`cablejax measure --all`: every cable of a scan, with its number in table, CSV, picture and report."""

import argparse
import csv
import io
from pathlib import Path
from typing import Any

from cablejax.cli import exports, measure_input, standards
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import check_output, rows, save_bytes, say
from cablejax.optional import require

COLUMNS: tuple[str, ...] = (
    "file", "number", "diameter_mm", "low_mm", "high_mm", "std_mm", "ovality", "length_mm", "bend_radius_mm", "arc_deg",
    "noise_mm", "points", "x_mm", "y_mm", "z_mm", "verdict", "conformity", "reason",
)  # fmt: skip
ROW: tuple[str, ...] = (
    "diameter_mm", "std_mm", "ovality", "length_mm", "bend_radius_mm", "arc_deg", "noise_mm", "points", "verdict",
    "conformity",
)  # fmt: skip


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Measure every cable, judge each, write CSV, picture and report."""
    _check(options)
    scan, _, given = measure_input.read_labelled(options)
    from cablejax.measure import MeasureError, measure_cables

    say(options, f"looking for cables in {len(scan.xyz_mm):,} points")
    try:
        scene = measure_cables(scan.xyz_mm, **given, expect=options.expect)
    except MeasureError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    result = {"file": str(scan.path), "file_unit": scan.unit, "dropped": scan.dropped, **scene.to_dict()}
    for one in result["cables"]:
        one["conformity"] = measure_input.conformity_of(options, one["diameter_mm"], one["std_mm"])
    result |= {
        "tolerance_mm": options.tolerance,
        "expected": options.expect,
        "exported": _exported(options, scan, scene),
    }
    if options.csv is not None:
        save_bytes(options.csv, _csv(result).encode(errors="backslashreplace"))
    if options.picture is not None or options.report is not None:
        _draw(options, scene, scan.xyz_mm)
    return result


def _exported(options: argparse.Namespace, scan: Any, scene: Any) -> list[str] | None:
    """The files written of all cables; None without `--export`."""
    if options.export is None:
        return None
    written = []
    for number, one in enumerate(scene.cables, 1):
        said = standards.read_and_sized(one, options.tolerance)
        written += exports.write(options, scan, one, *said, number=number) or []
    return written


def _check(options: argparse.Namespace) -> None:
    """Refuse what cannot be done before the work is done.

    Raises:
        NoResultError: Naming the option.
    """
    exports.check(options)
    if options.expect is not None and options.expect < 1:
        raise NoResultError(f"--expect: expected at least 1, got {options.expect}")
    measure_input.check_tolerance(options)
    measure_input.check_report(options, "jinja2", "matplotlib")
    if options.picture is not None:
        require("matplotlib", why="--picture")
        check_output(options.picture, (".png",))
    if options.csv is not None:
        check_output(options.csv, (".csv",))


def _draw(options: argparse.Namespace, scene: Any, xyz_mm: Any) -> None:
    from cablejax.report import cables_page, cables_picture

    if options.picture is not None:
        save_bytes(options.picture, cables_picture(scene, xyz_mm))
        say(options, f"picture: {options.picture}")
    if options.report is not None:
        page = cables_page(scene, title=Path(options.scan).name, source=str(options.scan), xyz_mm=xyz_mm)
        measure_input.save_report(options, page)


def rows_of(result: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows of the cables in a folder's table."""
    found = []
    for one in result["cables"]:
        low, high = one["interval_mm"]
        same = {name: one.get(name) for name in ROW}
        told = " ".join(one.get("warnings", ()))
        found.append({**same, "low_mm": low, "high_mm": high, **_middle(one), "warnings": told})
    return found


def _csv(result: dict[str, Any]) -> str:
    """A row a cable with the middle of its axis, then a row for everything round that could not be measured."""
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore", restval="")
    writer.writeheader()
    for one in result["cables"]:
        low, high = one["interval_mm"]
        writer.writerow({"file": result["file"], **one, "low_mm": low, "high_mm": high, **_middle(one)})
    for one in result["not_measured"]:
        about = {"diameter_mm": one["diameter_mm"], "length_mm": one["length_mm"], "reason": one["reason"]}
        writer.writerow({"file": result["file"], **about, **_middle(one)})
    return stream.getvalue()


def _middle(one: dict[str, Any]) -> dict[str, float]:
    point = one["axis_mm"][len(one["axis_mm"]) // 2]
    return dict(zip(("x_mm", "y_mm", "z_mm"), point, strict=True))


def table(result: dict[str, Any]) -> str:
    """A line a cable, what could not be measured, and warnings."""
    pairs = []
    for one in result["cables"]:
        low, high = one["interval_mm"]
        told = f"{one['diameter_mm']:.3f} mm  (95 %: {low:.3f} to {high:.3f}), {one['length_mm']:.0f} mm long"
        told += f", {one['arc_deg']:.0f} degrees seen"
        told += "".join(f", {one[name]}" for name in ("verdict", "conformity") if one[name])
        pairs.append((f"cable {one['number']}", told))
    for one in result["not_measured"]:
        pairs.append((f"about {one['diameter_mm']:.3g} mm", f"not measured: {one['reason']}"))
    notes = [f"  note: {warning}" for warning in result["warnings"]]
    for one in result["cables"]:
        notes += [f"  note on cable {one['number']}: {warning}" for warning in one["warnings"]]
    return "\n".join([f"{result['file']}", rows(pairs), *([""] if notes else []), *notes])
