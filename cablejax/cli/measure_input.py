"""What `measure`, with `--all` or not, and the page of `app` do before and after measuring: check, read, label, judge."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cablejax.cli import measure_settings
from cablejax.cli.checkpoint import labels_of_package, parts_of
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import check_output, load, make_folder, save_bytes, say
from cablejax.optional import require

if TYPE_CHECKING:
    import numpy as np

    from cablejax.io import PointFile
    from cablejax.measure import CableMeasurement, PointLabels


class Labelled(NamedTuple):
    """A scan as it is handed to a measurement.

    Attributes:
        scan: The file read.
        part: The part that each point lies on, by the network of `--checkpoint`; None without one.
        given: Keyword arguments of `measure_cable` and `measure_cables`.
    """

    scan: "PointFile"
    part: "np.ndarray | None"
    given: dict[str, Any]


def check_tolerance(options: argparse.Namespace) -> None:
    """Refuse limits in the wrong order.

    Raises:
        NoResultError: Naming the option.
    """
    if options.tolerance is not None and not options.tolerance[0] < options.tolerance[1]:
        low, high = options.tolerance
        raise NoResultError(f"--tolerance: expected LOW below HIGH, got {low:g} {high:g}")


def check_report(options: argparse.Namespace, *packages: str) -> None:
    """Refuse a report that cannot be written, before the work is done.

    Raises:
        MissingPackageError: If one of the packages that it needs is not installed.
        NoResultError: If its folder cannot be made, or its name does not end in .html.
    """
    if options.report is not None:
        require(*packages, why="a report")
        make_folder(Path(options.report).parent)
        check_output(options.report, (".html", ".htm"))


def given(options: argparse.Namespace) -> dict[str, Any]:
    """Catalogue and settings for a measurement, by the names of its arguments.

    Raises:
        NoResultError: If an option names none, or is out of range.
    """
    return {
        "catalogue": measure_settings.sizes(options.catalogue),
        "settings": measure_settings.settings(options),
    }


def read_labelled(options: argparse.Namespace) -> Labelled:
    """Read the scan, and label its points where a network is given.

    Raises:
        NoResultError: If an option, the file or the network cannot be used.
    """
    found = given(options)  # what cannot be asked for is said before a large file is read
    scan = load(options, options.scan)
    part = parts_of(options, scan)
    return Labelled(scan, part, {**found, "on_cable": None if part is None else part == "cable"})


def measured(
    options: argparse.Namespace, scan: "PointFile", part: "np.ndarray | None", given: dict[str, Any]
) -> "tuple[CableMeasurement, np.ndarray | None, dict[str, Any] | None]":
    """The cable of a scan, by the search alone or, with `--labels`, by search and labels.

    Args:
        options: Of the command.
        scan: The file read.
        part: As `Labelled.part`.
        given: As `Labelled.given`.

    Returns:
        The measurement, the part that each point lies on where a network was asked, and with `--labels` the candidates.

    Raises:
        MeasureError: If there is no cable that can be measured.
        NoResultError: If the network's files are damaged.
    """
    from cablejax.measure import measure_cable, measure_labelled

    if options.checkpoint is not None or options.labels == "off":
        return measure_cable(scan.xyz_mm, **given), part, None
    seen: list[np.ndarray] = []

    def label() -> "PointLabels":
        found, labels = labels_of_package(options, scan)
        seen.append(found)
        return labels

    found = measure_labelled(scan.xyz_mm, label, **given)
    candidates = {
        "taken": found.taken,
        "search_mm": found.by_search.diameter_mm,
        "labels_mm": None if found.by_labels is None else found.by_labels.diameter_mm,
    }
    return found.result, seen[0] if seen else None, candidates


def conformity_of(options: argparse.Namespace, diameter_mm: float, std_mm: float) -> str | None:
    """The diameter against `--tolerance`: "pass", "fail" or "undecided"; None without one."""
    if options.tolerance is None:
        return None
    from cablejax.measure import conformity

    low, high = options.tolerance
    return conformity(diameter_mm, std_mm, low=low, high=high)


def save_report(options: argparse.Namespace, html: str) -> None:
    """Write the report and say so."""
    save_bytes(options.report, html.encode(errors="backslashreplace"))  # file names may be no text
    say(options, f"report: {options.report}")
