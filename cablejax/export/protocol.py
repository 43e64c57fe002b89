"""A measurement's protocol: one HTML page for printing on A4, or into a PDF, from any browser."""

from collections.abc import Mapping

from cablejax.measure import CableMeasurement, conformity
from cablejax.measure.standards import Readings, SectionSizes
from cablejax.report.measurement import profile_figure, section_figure
from cablejax.report.page import Page
from cablejax.report.style import figure_style


def protocol_page(
    measured: CableMeasurement,
    *,
    title: str,
    source: Mapping[str, str],
    read: Readings,
    sizes: SectionSizes | None,
    limits_mm: tuple[float, float] | None = None,
) -> str:
    """The page as one HTML document without scripts.

    Args:
        measured: The measurement.
        title: Of the page.
        source: What was measured, when and with what, by name.
        read: The readings after IEC 60811-203.
        sizes: Sizes of the section after ISO 14405-1, where the whole circumference was seen.
        limits_mm: Least and greatest diameter allowed.
    """
    page = Page(title, subtitle="Measurement of the overall diameter from a scan")
    for warning in measured.warnings:
        page.note(warning)
    page.table(["Scan", ""], [list(pair) for pair in source.items()], caption="What was measured.")
    page.section("Result")
    page.table(["Quantity", "value"], _result(measured, read, limits_mm), caption=_rule(read))
    if sizes is not None:
        page.table(
            ["Size of the section (ISO 14405-1)", "mm"],
            _sizes(sizes),
            caption="Of the smooth section common to the length.",
        )
    lines = [[line.source, f"{line.std_mm:.4f}", line.kind] for line in measured.budget]
    lines.append(["together", f"{measured.std_mm:.4f}", ""])
    page.section("Uncertainty")
    page.table(
        ["Source", "standard uncertainty (mm)", "type"],
        lines,
        caption="Evaluated after the GUM; the interval is 1.96 times as wide to either side.",
    )
    page.section("Along the cable")
    with figure_style():
        page.figure(
            profile_figure(measured),  # pyright: ignore[reportArgumentType] frozen, as in `measurement_page`
            alt="Diameter of each section along the cable.",
            caption="Circles fitted to sections, with 95 % intervals.",
        )
        page.figure(
            section_figure(measured, 1.0),  # pyright: ignore[reportArgumentType]
            alt="The points across the axis, with the fitted circle.",
            caption="All points seen along the axis.",
        )
    page.section("Signature")
    page.table(["Name", "date", "signature"], [["\u00a0", "\u00a0", "\u00a0" * 40]], caption="")
    return page.render()


def _result(m: CableMeasurement, read: Readings, limits: tuple[float, float] | None) -> list[list[str]]:
    low, high = m.interval_mm
    written = " and ".join(f"{value:.1f} mm" for value in read.readings_mm)
    rows = [
        ["overall diameter", f"{m.diameter_mm:.3f} mm"],
        ["its 95 % interval", f"{low:.3f} to {high:.3f} mm"],
        [f"reading, {read.method}", written],
        ["mean reading", f"{read.mean_mm:.1f} mm"],
    ]
    if limits is not None:
        sure = conformity(m.diameter_mm, m.std_mm, low=limits[0], high=limits[1])
        rows += [
            ["limits", f"{limits[0]:g} to {limits[1]:g} mm"],
            ["verdict on the reading", str(read.verdict)],
            ["verdict with the uncertainty (JCGM 106)", sure],
        ]
    if m.ovality is not None:
        rows.append(["ovality", f"{100 * m.ovality:.2f} %"])
    return [*rows, ["length seen", f"{m.length_mm:.1f} mm"], ["circumference seen", f"{m.arc_deg:.0f} degrees"]]


def _rule(read: Readings) -> str:
    rule = "Readings after IEC 60811-203: two perpendicular ones up to 25 mm, by the circumference above"
    return f"{rule}; here to {read.step_mm} mm."


def _sizes(sizes: SectionSizes) -> list[list[str]]:
    return [
        ["least squares (GG)", f"{sizes.least_squares_mm:.3f}"],
        ["minimum zone (GC)", f"{sizes.minimum_zone_mm:.3f}"],
        ["maximum inscribed (GX)", f"{sizes.maximum_inscribed_mm:.3f}"],
        ["minimum circumscribed (GN)", f"{sizes.minimum_circumscribed_mm:.3f}"],
        [
            "two-point, least and greatest (LP)",
            f"{sizes.two_point_minimum_mm:.3f} and {sizes.two_point_maximum_mm:.3f}",
        ],
        ["deviation from roundness", f"{sizes.roundness_mm:.3f}"],
    ]
