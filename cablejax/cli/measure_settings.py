"""What the user knows beside the scan: the catalogue, the scanner, standard deviations."""

import argparse
from dataclasses import fields
from typing import TYPE_CHECKING

from cablejax.cli.errors import NoResultError

if TYPE_CHECKING:
    from cablejax.measure import Instrument, MeasureSettings, SearchLimits


def sizes(voltage: str | None) -> dict[str, float] | None:
    """Overall diameter in mm by name, of the catalogue for a rated voltage.

    Raises:
        NoResultError: If there is none for it.
    """
    if voltage is None:
        return None
    from cablejax.simulate import catalogue

    try:
        return {cable.name: float(cable.diameter_mm) for cable in catalogue(voltage)}
    except ValueError as error:
        raise NoResultError(f"--catalogue {voltage}: {error}") from None


def instrument(given: str | None) -> "Instrument | None":
    """The scanner of `--scanner`: a preset of the simulator, or numbers by name.

    Raises:
        NoResultError: If it is neither.
    """
    if given is None:
        return None
    from cablejax.measure import Instrument
    from cablejax.simulate import PRESETS

    if "=" not in given:
        if given not in PRESETS:
            raise NoResultError(
                f"--scanner {given}: expected one of {', '.join(PRESETS)}, or numbers: range_std_mm=1.2"
            )
        device = PRESETS[given]
        lateral = 1e-3 * device.jitter_mrad * device.standoff_mm
        return Instrument(device.range_mm, device.incidence_power, lateral, device.footprint_mm)
    try:
        numbers = {name.strip(): float(value) for name, value in (pair.split("=") for pair in given.split(","))}
        return Instrument(**numbers)
    except TypeError:
        names = ", ".join(field.name for field in fields(Instrument))
        raise NoResultError(f"--scanner {given}: expected range_std_mm, and no other names than {names}") from None
    except ValueError as error:
        raise NoResultError(f"--scanner {given}: {error}") from None


def limits(options: argparse.Namespace) -> "SearchLimits":
    """What is known of the cables that are sought.

    Raises:
        NoResultError: If it cannot be.
    """
    from cablejax.measure import SearchLimits

    box = options.box
    try:
        return SearchLimits(
            diameter_mm=None if options.diameter is None else tuple(options.diameter),
            axis=None if options.axis is None else tuple(options.axis),
            near_mm=None if options.near is None else tuple(options.near),
            box_mm=None if box is None else ((box[0], box[1], box[2]), (box[3], box[4], box[5])),
        )
    except ValueError as error:
        raise NoResultError(f"--{error}".replace("_mm:", ":", 1)) from None


def settings(options: argparse.Namespace) -> "MeasureSettings":
    """The settings of a measurement.

    Raises:
        NoResultError: If the scanner is none, or a number is out of range.
    """
    from cablejax.measure import MeasureSettings
    from cablejax.measure.depth_image import LENS_STD

    if options.stations is not None and options.stations < 1:
        raise NoResultError(f"--stations: expected at least 1, got {options.stations}")
    if options.lens_std is not None and not 0 <= options.lens_std < float("inf"):
        raise NoResultError(f"--lens-std: expected a number of at least 0, got {options.lens_std}")
    return MeasureSettings(
        section_mm=options.section,
        registration_std_mm=options.registration_std,
        scale_std=options.scale_std,
        maker_std_mm=options.maker_std,
        lens_std=LENS_STD if options.lens_std is None else options.lens_std,
        stations=options.stations,
        instrument=instrument(options.scanner),
        limits=limits(options),
        seed=options.seed,
    )
