"""What `measure` says in the words of standards, beside its own numbers."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablejax.measure import CableMeasurement
    from cablejax.measure.standards import Readings, SectionSizes


def read_and_sized(
    measured: "CableMeasurement", tolerance: list[float] | None
) -> "tuple[Readings, SectionSizes | None]":
    """Readings after IEC 60811-203, and sizes after ISO 14405-1 where the whole circumference was seen."""
    from cablejax.measure.standards import readings, section_sizes

    free, across = measured.free_section, None
    if free is not None:
        across = free.square_mm
    elif measured.minimum_mm is not None and measured.maximum_mm is not None:
        across = (measured.maximum_mm, measured.minimum_mm)
    limits = None if tolerance is None else (tolerance[0], tolerance[1])
    diameter = measured.diameter_mm if free is None else free.diameter_mm
    read = readings(diameter, across_mm=across, limits_mm=limits)
    return read, None if free is None else section_sizes(free.angle_deg, free.radius_mm)


def as_json(read: "Readings", sizes: "SectionSizes | None") -> dict[str, Any]:
    """Both for a result."""
    found = read._asdict() | {"readings_mm": list(read.readings_mm)}
    return {"readings": found, "section_sizes": None if sizes is None else sizes._asdict()}


def lines(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Both for the table."""
    read, sizes = result["readings"], result["section_sizes"]
    written = " and ".join(f"{value:.1f}" for value in read["readings_mm"])
    verdict = "" if read["verdict"] is None else f", {read['verdict']}"
    found = [("reading (IEC 60811-203)", f"{written} mm, {read['method']}{verdict}")]
    if sizes is not None:
        names = {"least_squares_mm": "least squares", "minimum_zone_mm": "minimum zone"}
        names |= {"maximum_inscribed_mm": "inscribed", "minimum_circumscribed_mm": "circumscribed"}
        text = ", ".join(f"{name} {sizes[key]:.3f}" for key, name in names.items())
        found.append(("sizes (ISO 14405-1)", f"{text} mm"))
    return found
