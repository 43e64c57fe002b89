"""`cablejax measure`: the cable in a scan, with its diameter and what is known about it."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablejax.cli import batch
from cablejax.cli.main import NoResultError
from cablejax.cli.scans import check_output, load, rows, say

if TYPE_CHECKING:
    from cablejax.io import PointFile
    from cablejax.measure import CableMeasurement


def _sizes(voltage: str | None) -> dict[str, float] | None:
    """Overall diameter in mm by name, of the catalogue for a rated voltage."""
    if voltage is None:
        return None
    from cablejax.simulate import catalogue

    try:
        return {cable.name: float(cable.diameter_mm) for cable in catalogue(voltage)}
    except ValueError as error:
        raise NoResultError(f"--catalogue {voltage}: {error}") from None


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Measure a scan, or every scan of a folder."""
    if Path(options.scan).is_dir() and options.command == "measure":
        return batch.run_folder(options, _one)
    if options.csv is not None:
        raise NoResultError("--csv: is for a folder of scans; give --json for one")
    return _one(options)


def _one(options: argparse.Namespace) -> dict[str, Any]:
    """Read, measure, judge, write the report."""
    if options.tolerance is not None and not options.tolerance[0] < options.tolerance[1]:
        raise NoResultError(
            f"--tolerance: expected LOW below HIGH, got {options.tolerance[0]:g} {options.tolerance[1]:g}"
        )
    if options.report is not None:
        Path(options.report).parent.mkdir(parents=True, exist_ok=True)
        check_output(options.report, (".html", ".htm"))
    sizes = _sizes(options.catalogue)
    scan = load(options, options.scan)
    from cablejax.measure import MeasureError, MeasureSettings, conformity, measure_cable

    settings = MeasureSettings(
        section_mm=options.section,
        registration_std_mm=options.registration_std,
        scale_std=options.scale_std,
        maker_std_mm=options.maker_std,
        seed=options.seed,
    )
    say(options, f"measuring {len(scan.xyz_mm):,} points")
    try:
        result = measure_cable(scan.xyz_mm, catalogue=sizes, settings=settings)
    except MeasureError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    if options.report is not None:
        _write_report(options, scan, result)
    judged = None
    if options.tolerance is not None:
        low, high = options.tolerance
        judged = conformity(result.diameter_mm, result.std_mm, low=low, high=high)
    return {
        "file": str(scan.path),
        "file_unit": scan.unit,
        "dropped": scan.dropped,
        **result.to_dict(),
        "tolerance_mm": options.tolerance,
        "conformity": judged,
    }


def _write_report(options: argparse.Namespace, scan: "PointFile", result: "CableMeasurement") -> None:
    from cablejax import report

    page = getattr(report, "measurement_page", None)
    if page is None:
        sys.stderr.write("cablejax: warning: --report: this version cannot write the report of a measurement\n")
        return
    html = page(result, title=Path(options.scan).name, source=str(options.scan), xyz_mm=scan.xyz_mm)
    Path(options.report).write_text(html, encoding="utf-8")
    say(options, f"report: {options.report}")


def _interval(interval: list[float] | None, digits: str = ".3f") -> str:
    return "" if interval is None else f"  (95 %: {interval[0]:{digits}} to {interval[1]:{digits}})"


def table(result: dict[str, Any]) -> str:
    """The result for reading: numbers, budget, nominal sizes, warnings."""
    if "scans" in result:
        return batch.table(result)
    r = result
    bend = "straight within its uncertainty"
    if r["bend_radius_mm"] is not None:
        bend = f"{r['bend_radius_mm']:.0f} mm{_interval(r['bend_interval_mm'], '.0f')}"
        bend += f", {r['bend_radius_mm'] / r['diameter_mm']:.1f} diameters"
    pairs = [("diameter", f"{r['diameter_mm']:.3f} mm{_interval(r['interval_mm'])}")]
    if r["ovality"] is not None:
        across = f"{r['minimum_mm']:.3f} mm by {r['maximum_mm']:.3f} mm"
        pairs.append(("ovality", f"{100 * r['ovality']:.2f} % +- {196 * r['ovality_std']:.2f} %, {across}"))
    if r["free_section"] is not None:
        jaws = r["free_section"]["square_mm"]
        round_ = f"{r['free_section']['diameter_mm']:.3f} mm round by its perimeter"
        pairs.append(("free-form section", f"{jaws[0]:.3f} mm by {jaws[1]:.3f} mm between jaws, {round_}"))
    pairs += [
        ("length", f"{r['length_mm']:.1f} mm"),
        ("bend radius", bend),
        ("least bend radius", ", ".join(f"{name} {judged}" for name, judged in r["bend_conformity"].items())),
        ("seen", f"{r['arc_deg']:.0f} degrees of the circumference, {r['points']:,} points"),
        ("noise", f"{r['noise_mm']:.3f} mm (standard deviation about the surface)"),
    ]
    if r["verdict"] is not None:
        pairs.append(("nominal size", r["verdict"]))
    if r["conformity"] is not None:
        low, high = r["tolerance_mm"]
        pairs.insert(1, ("within tolerance", f"{r['conformity']} ({low:g} to {high:g} mm)"))
    for one in r["irregularities"]:
        pairs.append((one["kind"], f"at {one['from_mm']:.0f} to {one['to_mm']:.0f} mm, {one['change_mm']:+.2f} mm"))
    parts = [f"{r['file']}", rows(pairs), "", "  uncertainty of the diameter (standard deviation)"]
    total = ("together", f"{r['std_mm']:.4f} mm")
    parts.append(rows([*((line["source"], f"{line['std_mm']:.4f} mm") for line in r["budget"]), total]))
    likely = [(name, f"{100 * p:.1f} %") for name, p in r["nominal"].items() if p >= 0.001]
    if likely:
        parts += ["", "  probability of the nominal sizes", rows(likely)]
    parts += ["", *(f"  note: {warning}" for warning in r["warnings"])] if r["warnings"] else []
    return "\n".join(parts)
