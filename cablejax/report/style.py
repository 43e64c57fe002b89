"""How figures look: readable in grey and by the colour-blind, the same in report, notebook and README."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import TYPE_CHECKING, Any

from cablejax.optional import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's palette in an order whose lightness alternates, so that neighbours differ in grey too.
COLORS = ("#0072B2", "#E69F00", "#000000", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
LINES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))


@contextmanager
def figure_style() -> Iterator[None]:
    """Matplotlib's settings for everything drawn inside the block; nothing global changes."""
    require("matplotlib", "cycler", why="a figure")
    import matplotlib as mpl
    from cycler import cycler

    settings: dict[Any, Any] = {
        "axes.prop_cycle": cycler(color=COLORS) + cycler(linestyle=[*LINES]),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "grid.linewidth": 0.6,
        "font.size": 10,
        "legend.frameon": False,
        "figure.constrained_layout.use": True,
        "savefig.dpi": 160,
    }
    with mpl.rc_context(settings):
        yield


def line_styles() -> Iterator[dict[str, Any]]:
    """Colour and dash of one curve after the other, without end."""
    for color, line in cycle(zip(COLORS, LINES, strict=True)):
        yield {"color": color, "linestyle": line}


def png_bytes(figure: "Figure") -> bytes:
    """A figure as a PNG image, without the date that would change its bytes from day to day."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def data_uri(png: bytes) -> str:
    """A PNG image as a `data:` address, so that a page needs no second file."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
