"""Points in 3-D, coloured by their deviation: an interactive scene for pages, a static view for paper."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 20_000
SCALE = "RdBu"


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
    """An HTML fragment with the clouds in one rotatable scene, switched by buttons; `Page` brings the script it needs.

    Args:
        clouds: Name of each view -> points `[n, 3]` and the value `[n]` that colours them.
        label: Name of the value, with its unit.
        limit: Colours run from -limit to +limit.
        unit: Unit of the coordinates, for the axes.
    """
    import plotly.graph_objects as go

    names = list(clouds)
    figure = go.Figure()
    for i, (name, (xyz, value)) in enumerate(clouds.items()):
        rows = thin(len(xyz))
        x, y, z = np.round(xyz[rows].T, 3)
        marker = {
            "size": 1.8,
            "color": np.round(value[rows], 4),
            "colorscale": SCALE,
            "cmin": -limit,
            "cmax": limit,
            "colorbar": {"title": {"text": label, "side": "right"}, "thickness": 12},
        }
        figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, name=name, visible=i == 0))
    buttons = [
        {"label": name, "method": "update", "args": [{"visible": [other == name for other in names]}]} for name in names
    ]
    axes = {axis: {"title": {"text": f"{axis[0]} ({unit})"}} for axis in ("xaxis", "yaxis", "zaxis")}
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
        scene={"aspectmode": "data", **axes},
        updatemenus=menu if len(names) > 1 else [],
        margin={"l": 0, "r": 0, "t": 50, "b": 0},
    )
    return figure.to_html(full_html=False, include_plotlyjs=False, config={"responsive": True, "displaylogo": False})


def point_views(
    clouds: Mapping[str, tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]], *, label: str, limit: float
) -> "Figure":
    """The same clouds side by side, seen along their second-longest direction, as a static figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.2 + 2.0 * len(clouds)))
    axes = figure.subplots(len(clouds), 1, sharex=True, squeeze=False)[:, 0]
    first = next(iter(clouds.values()))[0]
    centre = first.mean(axis=0)
    _, _, directions = np.linalg.svd(first[thin(len(first), most=5000)] - centre, full_matrices=False)
    drawn = None
    for ax, (name, (xyz, value)) in zip(axes, clouds.items(), strict=True):
        rows = thin(len(xyz))
        along, across = ((xyz[rows] - centre) @ directions[:2].T).T
        drawn = ax.scatter(along, across, c=value[rows], s=1.2, cmap=SCALE, vmin=-limit, vmax=limit, rasterized=True)
        ax.set_title(name, loc="left")
        ax.set_ylabel("across (mm)")
        ax.set_aspect("equal", adjustable="datalim")
    axes[-1].set_xlabel("along the cable (mm)")
    figure.colorbar(drawn, ax=list(axes), label=label)
    return figure
