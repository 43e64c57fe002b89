"""The page of one measured scan: the numbers, where they come from, and the scan itself."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from cablejax.geometry.robust import COVERAGE
from cablejax.geometry.words import where
from cablejax.optional import require
from cablejax.report.page import Page
from cablejax.report.scene import SCALE, point_scene
from cablejax.report.style import COLORS, figure_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAP_POINTS = 30_000
WIDEST_SECTION = 0.05  # standard deviation over the diameter above which a section says too little to be drawn


@runtime_checkable
class Measured(Protocol):
    """What the page reads of a measurement; `cablejax.measure.CableMeasurement` is one."""

    diameter_mm: Any
    std_mm: Any
    interval_mm: Any
    minimum_mm: Any
    maximum_mm: Any
    ovality: Any
    ovality_std: Any
    length_mm: Any
    bend_radius_mm: Any
    bend_interval_mm: Any
    arc_deg: Any
    noise_mm: Any
    points: Any
    sections: Any
    stretches: Any
    form: str
    keep: Any
    deviation_mm: Any
    along_mm: Any
    angle_deg: Any
    budget: Any
    free_section: Any
    bend_verdicts: Any
    irregularities: Any
    nominal: Mapping[str, float]
    verdict: str | None
    warnings: Sequence[str]


def measurement_page(
    measured: Measured, *, title: str, source: str, xyz_mm: np.ndarray, parts: Mapping[str, int] | None = None
) -> str:
    """The page as one HTML document.

    Args:
        measured: The measurement.
        title: The page's heading, such as the scan's name.
        source: Where the scan came from, and in what unit.
        xyz_mm: The scan's points `[n, 3]`, in the order that was measured.
        parts: Points of each part, where a network has labelled the scan.
    """
    low, high = measured.interval_mm
    page = Page(
        f"{title}: {measured.diameter_mm:.2f} mm", subtitle=f"95 % interval {low:.2f} to {high:.2f} mm. {source}"
    )
    for warning in measured.warnings:
        page.note(warning)
    page.section("Result")
    page.table(["Quantity", "value", "95 % interval"], quantities(measured), caption="All lengths in millimetres.")
    if measured.nominal:
        rows = [[name, f"{100 * p:.1f} %"] for name, p in measured.nominal.items() if p >= 0.001]
        page.table(["Nominal size", "probability"], rows, caption=f"Verdict: {measured.verdict}")
    if parts:
        total = sum(parts.values())
        rows = [[name, f"{count:,}", f"{100 * count / total:.1f} %"] for name, count in parts.items()]
        page.table(
            ["Part", "points", "share"],
            rows,
            caption="As a network labelled the scan; the cable's points were measured.",
        )
    if measured.form != "one diameter":
        page.table(
            ["Stretch", "where along (mm)", "diameter (mm)", "95 % interval"],
            [row for one in measured.stretches for row in _stretch(one)],
            caption=f"Along its length: {measured.form}.",
        )
    if measured.irregularities:
        rows = [[one.kind, where(one.from_mm, one.to_mm), f"{one.change_mm:+.2f}"] for one in measured.irregularities]
        page.table(
            ["Irregularity", "where along (mm)", "change of the diameter (mm)"], rows, caption="Off the local mean."
        )
    magnify = _magnification(measured)
    page.section("Along the cable")
    with figure_style():
        page.figure(
            profile_figure(measured),
            alt="Diameter of each section along the cable with its 95 % interval.",
            caption="Circles fitted to slabs along the axis, each with its 95 % interval; the band is the overall diameter's. "
            "Triangles are the least and greatest diameter of each slab, where enough of it was seen. "
            f"Sections known to worse than {100 * WIDEST_SECTION:g} % are left out.",
        )
        page.figure(
            _surface(measured),
            alt="The surface unrolled: deviation from the fitted surface against place along and angle about the axis.",
            caption="The surface unrolled. Colour is the distance from the fitted surface, positive outside.",
        )
        page.figure(
            section_figure(measured, magnify),
            alt="All points of the cable in the plane across its axis, with the fitted circle.",
            caption="All points of the cable seen along its axis, the fitted circle"
            + ("" if measured.free_section is None else ", dashed the free-form section")
            + (f", deviations drawn {magnify:g} times as large as they are." if magnify > 1 else "."),
        )
    page.section("The scan")
    clouds = _clouds(measured, xyz_mm)
    page.scene(
        point_scene(clouds, label="deviation (mm)", limit=3 * measured.noise_mm),
        caption="To turn and zoom, thinned. Colour is the distance from the fitted surface; points far off it are grey.",
    )
    page.section("Uncertainty")
    budget_table(page, measured)
    return page.render()


def _stretch(one: Any) -> list[list[str]]:
    """A row, or one for either end of a tapering stretch."""
    ends = zip((one.first_mm, one.last_mm), one.intervals_mm, strict=True)
    rows = [
        [one.kind, where(one.from_mm, one.to_mm), f"{value:.2f}", f"{low:.2f} to {high:.2f}"]
        for value, (low, high) in ends
    ]
    return rows if one.kind == "tapering" else rows[:1]


def budget_table(page: Page, measured: Measured) -> None:
    """Add the sources of the diameter's uncertainty to a page."""
    lines = [[line.source, f"{line.std_mm:.4f}", line.kind, line.how] for line in measured.budget]
    lines.append(["together", f"{measured.std_mm:.4f}", "", "square root of the sum of squares"])
    page.table(
        ["Source of the diameter's uncertainty", "std (mm)", "type", "how it was come by"],
        lines,
        caption="Type A from the scan's own statistics, type B from other knowledge (GUM).",
    )


def quantities(m: Measured) -> list[list[str]]:
    """The numbers of a measurement, with their intervals."""

    def interval(bounds: Sequence[float] | None, digits: int) -> str:
        return "" if bounds is None else f"{bounds[0]:,.{digits}f} to {bounds[1]:,.{digits}f}"

    rows = [["diameter", f"{m.diameter_mm:.3f}", interval(m.interval_mm, 3)]]
    if m.ovality is not None:
        half = COVERAGE * m.ovality_std
        rows += [
            ["least and greatest diameter", f"{m.minimum_mm:.3f} and {m.maximum_mm:.3f}", ""],
            ["ovality (%)", f"{100 * m.ovality:.2f}", f"± {100 * half:.2f}"],
        ]
    rows += _shape(m)
    bend = "straight within its uncertainty" if m.bend_radius_mm is None else f"{m.bend_radius_mm:,.0f}"
    return [
        *rows,
        ["length", f"{m.length_mm:,.1f}", ""],
        ["least bend radius", bend, interval(m.bend_interval_mm, 0)],
        *([f"bend radius of at least {name}", verdict, ""] for name, verdict in m.bend_verdicts.items()),
        ["circumference seen (degrees)", f"{m.arc_deg:.0f}", ""],
        ["noise about the surface", f"{m.noise_mm:.3f}", ""],
        ["points", f"{m.points:,}", ""],
    ]


def _shape(m: Measured) -> list[list[str]]:
    """Least and greatest diameter along the length, and the free-form section's sizes, where they are known."""
    rows = []
    low, high = (np.asarray(values, dtype=float) for values in (m.sections.minimum_mm, m.sections.maximum_mm))
    known = np.isfinite(low) & (np.asarray(m.sections.oval_std_mm, dtype=float) < WIDEST_SECTION * m.diameter_mm)
    if known.any():
        share = 100 * (high - low)[known] / m.diameter_mm
        rows += [
            ["least and greatest of all sections", f"{low[known].min():.3f} and {high[known].max():.3f}", ""],
            ["ovality of the sections, middle and greatest (%)", f"{np.median(share):.2f} and {share.max():.2f}", ""],
        ]
    if (free := m.free_section) is not None:
        half = COVERAGE * free.diameter_std_mm
        rows += [
            ["free-form section, by its perimeter", f"{free.diameter_mm:.3f}", f"± {half:.3f} from noise"],
            ["between jaws, greatest and square to it", f"{free.square_mm[0]:.3f} and {free.square_mm[1]:.3f}", ""],
            ["between jaws, least", f"{free.minimum_mm:.3f}", ""],
        ]
    return rows


def _figure(width: float, height: float) -> "Figure":
    require("matplotlib", why="a figure")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def profile_figure(m: Measured) -> "Figure":
    """The diameter of each section along the cable."""
    figure = _figure(6.6, 3.0)
    ax = figure.subplots()
    s, d, std = (np.asarray(a, dtype=float) for a in (m.sections.s_mm, m.sections.diameter_mm, m.sections.std_mm))
    seen = np.isfinite(d) & (std < WIDEST_SECTION * m.diameter_mm)
    ax.errorbar(
        s[seen], d[seen], COVERAGE * std[seen], fmt="o", ms=3, lw=1, capsize=0, color=COLORS[0], label="section"
    )
    for values, marker in ((m.sections.minimum_mm, "v"), (m.sections.maximum_mm, "^")):
        edge = np.asarray(values, dtype=float)
        drawn = seen & np.isfinite(edge)
        ax.plot(s[drawn], edge[drawn], marker, ms=2.5, ls="none", color=COLORS[4])
    ax.axhspan(*m.interval_mm, color=COLORS[1], alpha=0.35, lw=0)
    ax.axhline(m.diameter_mm, color=COLORS[2], lw=1, ls="-", label="overall diameter and its 95 % interval")
    ax.set_xlabel("along the axis (mm)")
    ax.set_ylabel("diameter (mm)")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def _surface(m: Measured) -> "Figure":
    figure = _figure(6.6, 3.2)
    ax = figure.subplots()
    on = np.flatnonzero(np.asarray(m.keep))
    on = on[:: max(1, len(on) // MAP_POINTS)]
    limit = 3 * m.noise_mm
    angle = np.mod(np.asarray(m.angle_deg)[on] + 180, 360) - 180
    deviation = np.asarray(m.deviation_mm)[on]
    drawn = ax.scatter(
        np.asarray(m.along_mm)[on], angle, c=deviation, s=2, cmap=SCALE, vmin=-limit, vmax=limit, rasterized=True
    )
    ax.set_ylim(-180, 180)
    ax.set_yticks([-180, -90, 0, 90, 180])
    ax.set_xlabel("along the axis (mm)")
    ax.set_ylabel("angle about the axis (degrees)")
    figure.colorbar(drawn, label="deviation (mm)")
    return figure


def _magnification(m: Measured) -> float:
    """1, 2, 5, 10, ...: the largest that draws four standard deviations of noise within a third of the radius."""
    most = m.diameter_mm / 6 / max(4 * m.noise_mm, 1e-9)
    steps = [float(f"{digit}e{power}") for power in range(4) for digit in (1, 2, 5)]
    return max([step for step in steps if step <= most], default=1.0)


def section_figure(m: Measured, magnify: float) -> "Figure":
    """The points of the cable seen along its axis, their deviations magnified, with the fitted circle."""
    figure = _figure(6.6, 5.2)
    ax = figure.subplots()
    on = np.asarray(m.keep)
    angle, radius = np.radians(np.asarray(m.angle_deg)[on]), m.diameter_mm / 2
    drawn = radius + magnify * np.asarray(m.deviation_mm)[on]
    ax.plot(
        drawn * np.cos(angle), drawn * np.sin(angle), ".", ms=1, ls="none", color=COLORS[0], alpha=0.4, rasterized=True
    )
    circle = np.linspace(0, 2 * np.pi, 400)
    ax.plot(radius * np.cos(circle), radius * np.sin(circle), color=COLORS[6], lw=1.2, ls="-")
    if (free := m.free_section) is not None:
        turn = np.radians(np.append(free.angle_deg, free.angle_deg[:1]))
        shape = radius + magnify * (np.append(free.radius_mm, free.radius_mm[:1]) - radius)
        ax.plot(shape * np.cos(turn), shape * np.sin(turn), color=COLORS[2], lw=1.0, ls="--")
    ax.set_xlim(-1.45 * radius, 1.45 * radius)
    ax.set_ylim(-1.45 * radius, 1.45 * radius)
    ax.set_aspect("equal")
    ax.set_xlabel("across the axis (mm)")
    ax.set_ylabel("across the axis (mm)")
    return figure


def _clouds(m: Measured, xyz_mm: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The cable alone, and the whole scan, each with its deviations."""
    keep, deviation = np.asarray(m.keep), np.asarray(m.deviation_mm)
    centred = xyz_mm - xyz_mm[keep].mean(axis=0)
    return {"the cable": (centred[keep], deviation[keep]), "the whole scan": (centred, deviation)}
