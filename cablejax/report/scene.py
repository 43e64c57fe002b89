"""Points in 3-D, coloured by their deviation: an interactive scene for pages, a static view for paper."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from cablejax.geometry.principal import principal_axes
from cablejax.optional import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from plotly.graph_objects import Figure as Figure3D

MOST_POINTS = 12_000
SCALE = "RdBu_r"  # blue inside, red outside, as on the page of `cablejax app`


def thin(n: int, *, most: int = MOST_POINTS) -> np.ndarray:
    """Indices of at most `most` of n rows, evenly strided, so that a page stays light."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64)) if n else np.zeros(0, np.int64)


def point_scene(
    clouds: Mapping[str, tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]],
    *,
    label: str,
    limit: float,
    unit: str = "mm",
) -> str:
    """`scene_figure` as an HTML fragment; `Page` brings the script it needs."""
    figure = scene_figure(clouds, label=label, limit=limit, unit=unit)
    return figure.to_html(full_html=False, include_plotlyjs=False, config={"responsive": True, "displaylogo": False})


def scene_figure(
    clouds: Mapping[str, tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]],
    *,
    label: str,
    limit: float,
    unit: str = "mm",
) -> "Figure3D":
    """The clouds in one rotatable plotly figure, switched by buttons.

    Args:
        clouds: Name of each view -> points `[n, 3]` and the value `[n]` that colours them.
        label: Name of the value, with its unit.
        limit: Colours run from -limit to +limit.
        unit: Unit of the coordinates, for the axes.
    """
    require("plotly", why="an interactive scene")
    import plotly.graph_objects as go

    names = list(clouds)
    figure = go.Figure()
    for i, (name, (xyz, value)) in enumerate(clouds.items()):
        known = np.isfinite(value)
        scale = {
            "color": value[known],
            "colorscale": SCALE,
            "cmin": -limit,
            "cmax": limit,
            "colorbar": {
                "title": {"text": label, "side": "top"},
                "orientation": "h",
                "y": 0,
                "yanchor": "top",
                "thickness": 10,
            },
        }
        figure.add_trace(_points(xyz[known], scale, name=name, visible=i == 0))
        figure.add_trace(_points(xyz[~known], {"color": "lightgrey"}, name=name, visible=i == 0))
    buttons = [
        {"label": name, "method": "update", "args": [{"visible": [other == name for other in names for _ in "ab"]}]}
        for name in names
    ]
    extent = np.ptp(next(iter(clouds.values()))[0], axis=0)
    axes = {
        f"{axis}axis": {"title": {"text": f"{axis} ({unit})"}, "nticks": 3 if side < extent.max() / 4 else 8}
        for axis, side in zip("xyz", extent, strict=True)
    }
    menu = [
        {
            "type": "buttons",
            "direction": "right",
            "x": 0,
            "y": 1.02,
            "xanchor": "left",
            "yanchor": "bottom",
            "buttons": buttons,
        }
    ]
    figure.update_layout(
        scene={"aspectmode": "data", "camera": _camera(next(iter(clouds.values()))[0]), **axes},
        updatemenus=menu if len(names) > 1 else [],
        modebar={"orientation": "v"},  # beside the scene: on a narrow page it would lie over the buttons
        margin={"l": 0, "r": 0, "t": 50, "b": 0},
    )
    return figure


def _points(xyz: np.ndarray, marker: dict[str, Any], *, name: str, visible: bool):
    """Thinned points as one trace; a colour per point is thinned along."""
    require("plotly", why="an interactive scene")
    import plotly.graph_objects as go

    rows = thin(len(xyz))
    x, y, z = np.round(xyz[rows].astype(np.float64), 3).T
    if not isinstance(marker["color"], str):
        marker = marker | {"color": np.round(marker["color"][rows].astype(np.float64), 4)}
    return go.Scatter3d(
        x=x, y=y, z=z, mode="markers", marker={"size": 1.8, **marker}, name=name, visible=visible, showlegend=False
    )


def _camera(xyz: np.ndarray) -> dict[str, Any]:
    """Look across the longest side, which then runs from left to right, from far enough to see all of it."""
    extent = np.maximum(np.ptp(xyz, axis=0), 1e-6)
    shortest, middle, _ = np.argsort(extent)
    aspect = extent / extent.prod() ** (1 / 3)
    eye = np.zeros(3)
    eye[middle], eye[shortest] = -max(1.6, 1.1 * aspect.max()), 0.4
    up = np.eye(3)[shortest]
    return {name: dict(zip("xyz", vector.tolist(), strict=True)) for name, vector in (("eye", eye), ("up", up))}


def point_views(
    clouds: Mapping[str, tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]], *, label: str, limit: float
) -> "Figure":
    """The same clouds side by side, seen along their second-longest direction, as a static figure."""
    require("matplotlib", why="a figure")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.6, 1.0 + 1.5 * len(clouds)))
    axes = figure.subplots(len(clouds), 1, sharex=True, squeeze=False)[:, 0]
    first = next(iter(clouds.values()))[0]
    centre, directions, _ = principal_axes(first[thin(len(first), most=5000)])
    for ax, (name, (xyz, value)) in zip(axes, clouds.items(), strict=True):
        rows = thin(len(xyz))
        along, across = ((xyz[rows] - centre) @ directions[:2].T).T
        ax.scatter(along, across, c=value[rows], s=1.2, cmap=SCALE, vmin=-limit, vmax=limit, rasterized=True)
        ax.set_title(name, loc="left")
        ax.set_ylabel("across (mm)")
        ax.set_aspect("equal", adjustable="datalim")
    axes[-1].set_xlabel("along the cable (mm)")
    figure.colorbar(axes[0].collections[0], ax=list(axes), label=label)
    return figure
