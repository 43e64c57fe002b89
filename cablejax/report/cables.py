"""The page and the picture of a scene with several cables, each by its number."""

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from cablejax.geometry.principal import facing_up
from cablejax.optional import require
from cablejax.report.measurement import Measured, budget_table, profile_figure, quantities
from cablejax.report.page import Page
from cablejax.report.scene import thin
from cablejax.report.style import COLORS, figure_style, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN = 40_000  # points of the scan


@runtime_checkable
class Cables(Protocol):
    """What the page reads of a scene; `cablejax.measure.CableScene` is one."""

    cables: Sequence[Any]
    label: Any
    not_measured: Sequence[Any]
    warnings: Sequence[str]


def cables_page(scene: Cables, *, title: str, source: str, xyz_mm: np.ndarray) -> str:
    """The page as one HTML document.

    Args:
        scene: Every cable of the scan.
        title: The page's heading, such as the scan's name.
        source: Where the scan came from, and in what unit.
        xyz_mm: The scan's points `[n, 3]`, in the order that was measured.
    """
    page = Page(f"{title}: {len(scene.cables)} cables", subtitle=source)
    for warning in scene.warnings:
        page.note(warning)
    page.section("Cables")
    page.table(
        ["Number", "diameter (mm)", "95 % interval (mm)", "length (mm)", "seen (degrees)", "nominal size"],
        [_row(number, one) for number, one in enumerate(scene.cables, 1)],
        caption="Numbered as in the picture.",
    )
    page.figure(
        cables_picture(scene, xyz_mm),
        alt="The scan from above and along the cables, each cable in a colour with its number.",
        caption="The scan seen from above and along the cables. Points of no cable are grey; crosses are round things that "
        "could not be measured.",
    )
    if scene.not_measured:
        page.table(
            ["Not measured", "length (mm)", "why"],
            [[f"about {one.diameter_mm:.3g} mm", f"{one.length_mm:.0f}", one.reason] for one in scene.not_measured],
            caption="What looked like a cable and gave no diameter.",
        )
    for number, one in enumerate(scene.cables, 1):
        _section(page, number, one)
    return page.render()


def _row(number: int, one: Any) -> list[str]:
    low, high = one.interval_mm
    return [
        str(number),
        f"{one.diameter_mm:.3f}",
        f"{low:.3f} to {high:.3f}",
        f"{one.length_mm:.0f}",
        f"{one.arc_deg:.0f}",
        one.verdict or "",
    ]


def _section(page: Page, number: int, one: Measured) -> None:
    page.section(f"Cable {number}")
    for warning in one.warnings:
        page.note(warning)
    page.table(["Quantity", "value", "95 % interval"], quantities(one), caption="All lengths in millimetres.")
    with figure_style():
        page.figure(
            profile_figure(one),
            alt=f"Diameter of each section along cable {number} with its 95 % interval.",
            caption="Circles fitted to slabs along the axis, each with its 95 % interval.",
        )
    budget_table(page, one)


def cables_picture(scene: Cables, xyz_mm: np.ndarray) -> bytes:
    """The scan from above and along the cables as a PNG image, each cable in a colour with its number.

    Args:
        scene: Every cable of the scan.
        xyz_mm: The scan's points `[n, 3]`.
    """
    require("matplotlib", why="a picture")
    from matplotlib.figure import Figure

    along, across, up = _directions(scene, xyz_mm)
    with figure_style():
        figure = Figure(figsize=(8.0, 8.0))
        above, end = figure.subplots(2, 1)
        _panel(above, scene, xyz_mm, along, across)
        above.set(xlabel="along (mm)", ylabel="across (mm)", title="from above")
        _panel(end, scene, xyz_mm, across, up)
        end.set(xlabel="across (mm)", ylabel="up (mm)", title="along the cables")
        return png_bytes(figure)


def _directions(scene: Cables, xyz_mm: np.ndarray) -> np.ndarray:
    """Along most of the cables, across them where the scan is widest, and up: three unit vectors `[3, 3]`."""
    way = np.array([one.axis_mm[-1] - one.axis_mm[0] for one in scene.cables])
    along = np.linalg.svd(way, full_matrices=False)[2][0]
    along = facing_up(along)
    points = xyz_mm[np.asarray(scene.label) > 0]
    rest = points - points.mean(axis=0)
    rest = rest - np.outer(rest @ along, along)
    across = np.linalg.svd(rest[thin(len(rest))], full_matrices=False)[2][0]
    across = facing_up(across)
    return np.stack([along, across, np.cross(along, across)])


def _panel(ax: "Axes", scene: Cables, xyz_mm: np.ndarray, right: np.ndarray, up: np.ndarray) -> None:
    rows = thin(len(xyz_mm), most=DRAWN)
    x, y, label = xyz_mm[rows] @ right, xyz_mm[rows] @ up, np.asarray(scene.label)[rows]
    ax.plot(x[label == 0], y[label == 0], ".", ms=0.5, color="lightgrey", ls="none", rasterized=True)
    for number, (one, color) in enumerate(zip(scene.cables, cycle(COLORS), strict=False), 1):
        mine = label == number
        ax.plot(x[mine], y[mine], ".", ms=0.7, color=color, ls="none", rasterized=True)
        middle = one.axis_mm[len(one.axis_mm) // 2]
        frame = {"boxstyle": "circle,pad=0.2", "fc": "white", "ec": color, "lw": 1.0}
        ax.text(middle @ right, middle @ up, str(number), ha="center", va="center", fontsize=8, bbox=frame)
    for one in scene.not_measured:
        middle = one.axis_mm[len(one.axis_mm) // 2]
        ax.plot(middle @ right, middle @ up, "x", color="black", ms=7, ls="none", clip_on=True)
    # A wall behind must not make the cables small: the view is theirs, with a quarter to spare.
    for points, set_limits in ((right, ax.set_xlim), (up, ax.set_ylim)):
        place = xyz_mm[np.asarray(scene.label) > 0] @ points
        low, high = np.quantile(place, [0.001, 0.999])
        spare = 0.25 * (high - low) + 1e-6
        set_limits(low - spare, high + spare)
    ax.set_aspect("equal", adjustable="box")
