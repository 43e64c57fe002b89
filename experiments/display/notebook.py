"""What the notebooks show: sections of results/, read and drawn, nothing computed."""

import json
from pathlib import Path

from cablejax.report import figure_style, png_bytes, scene_figure
from experiments import ROOT
from experiments.analysis.results import Results
from experiments.display.drawing import Drawing
from experiments.display.filtering.figures import scan_clouds, scan_views
from experiments.display.section import Section
from experiments.display.sections import SHOWN
from experiments.display.table import Table

RESULTS = ROOT / "results"
DOTS_PER_INCH = 110  # of a page; the PNG holds more, for sharp screens and print


def section(title: str) -> Section:
    """A section by its title.

    Raises:
        ValueError: If there is none of that title.
    """
    found = {each.title: each for each in SHOWN}
    if title not in found:
        raise ValueError(f"title: expected one of {', '.join(found)}, got {title!r}")
    return found[title]


def show(title: str, *, results: Path = RESULTS) -> None:
    """Display every table and figure of a section; say so where its results were not made."""
    from IPython.display import Markdown, display

    this = section(title)
    if not this.read(results):
        display(Markdown(f"*No results yet: `{_maker(this.names[0])}` makes them.*"))
        return
    for table in this.made_tables(results):
        show_table(table)
    with figure_style():
        for drawing in this.made_figures(results):
            show_drawing(drawing)


def _maker(name: str) -> str:
    """The command that makes a results file."""
    return f"python -m {name.replace('/', '.')}" if name.startswith("benchmarks/") else f"make {name}"


def show_table(table: Table) -> None:
    """Display a table with its caption."""
    from IPython.display import HTML, Markdown, display

    display(Markdown(f"**{table.title}**"))
    display(HTML(table.to_html()))
    display(Markdown(table.caption))


def show_drawing(drawing: Drawing) -> None:
    """Display a figure as PNG with its caption and alternative text."""
    from IPython.display import Markdown, display

    png = {"image/png": png_bytes(drawing.figure), "text/plain": drawing.alt}
    display(png, metadata={"image/png": {"width": round(DOTS_PER_INCH * drawing.figure.get_figwidth())}}, raw=True)
    display(Markdown(f"*{drawing.caption}*"))


def show_scene(results: Path = RESULTS) -> None:
    """Display the scan of `diameter` to turn by hand where the viewer can, and as a PNG where it can't."""
    from IPython.display import display

    found = Results.read(results, "diameter")
    if found is None:
        return
    clouds, look = scan_clouds(found)
    with figure_style():
        drawing = scan_views(found)
        png = png_bytes(drawing.figure)
    scene = json.loads(scene_figure(clouds, **look).to_json() or "{}")
    display({"application/vnd.plotly.v1+json": scene, "image/png": png, "text/plain": drawing.alt}, raw=True)
