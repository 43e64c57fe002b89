"""One self-contained HTML page: sections of text, tables, figures and a 3-D scene that needs no network."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from cablejax.optional import require
from cablejax.report.style import data_uri, png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATE = Path(__file__).parent / "templates" / "page.html.jinja"

WORDY = 32  # a column with longer cells is set as text: to the left, and broken into lines


@cache
def _template():
    require("jinja2", "markupsafe", why="a report")
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["code"] = _with_code
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8"))


class Page:
    """A page under construction; blocks appear in the order in which they are added.

    Example:
        >>> page = Page("A scan", subtitle="one of many")
        >>> page.section("Result", "The diameter.")
        >>> page.table(["Quantity", "Value"], [["diameter", "34.1 mm"]], caption="What was measured.")
        >>> "<td>34.1 mm</td>" in page.render()
        True
    """

    def __init__(self, title: str, *, subtitle: str = "") -> None:
        self.title = title
        self.subtitle = subtitle
        self._blocks: list[dict[str, object]] = []
        self._needs_plotly = False

    def section(self, title: str, *paragraphs: str) -> None:
        """Begin a section: a heading, listed in the page's contents, and paragraphs, as `text` takes them."""
        self._blocks.append({"kind": "section", "title": title, "anchor": f"s{len(self._blocks)}"})
        for paragraph in paragraphs:
            self.text(paragraph)

    def text(self, paragraph: str) -> None:
        """Add a paragraph of plain text; it is escaped, and what stands between backticks is set as code."""
        self._blocks.append({"kind": "text", "text": paragraph})

    def note(self, text: str) -> None:
        """Add a paragraph that stands out: a warning, a verdict."""
        self._blocks.append({"kind": "note", "text": text})

    def table(
        self,
        header: Sequence[str],
        rows: Sequence[Sequence[object]],
        *,
        caption: str,
        groups: Sequence[tuple[str, int]] = (),
    ) -> None:
        """Add a table; cells are escaped, the first column is the row's name.

        Args:
            header: Names of the columns, with units.
            rows: One sequence of cells per row, as long as `header`.
            caption: What the table shows.
            groups: Headings above the header, each with the number of columns it spans.

        Raises:
            ValueError: If a row is not as long as the header.
        """
        for row in rows:
            if len(row) != len(header):
                raise ValueError(f"rows: expected {len(header)} cells as in the header, got {len(row)}: {list(row)}")
        wordy = [i > 0 and any(len(str(row[i])) > WORDY for row in rows) for i in range(len(header))]
        block = {
            "kind": "table",
            "header": header,
            "rows": rows,
            "caption": caption,
            "groups": list(groups),
            "wordy": wordy,
        }
        self._blocks.append(block)

    def figure(self, figure: "Figure | bytes", *, alt: str, caption: str) -> None:
        """Add a matplotlib figure, or a PNG image's bytes, embedded in the page."""
        png = figure if isinstance(figure, bytes) else png_bytes(figure)
        self._blocks.append({"kind": "figure", "source": data_uri(png), "alt": alt, "caption": caption})

    def scene(self, fragment: str, *, caption: str) -> None:
        """Add an interactive scene, as `cablejax.report.point_scene` makes it."""
        self._needs_plotly = True
        self._blocks.append({"kind": "scene", "html": fragment, "caption": caption})

    def render(self) -> str:
        """The page as one HTML document."""
        script = ""
        if self._needs_plotly:
            require("plotly", why="an interactive scene")
            from plotly.offline import get_plotlyjs

            script = f"<script>{get_plotlyjs()}</script>"
        return _template().render(
            title=self.title, subtitle=self.subtitle, blocks=self._blocks, script=_safe(script), safe=_safe
        )


def _with_code(text: object):
    """Plain text as HTML, with what stands between backticks set as code."""
    import markupsafe

    parts = [markupsafe.escape(part) for part in str(text).split("`")]
    if len(parts) % 2 == 0:  # a backtick without its pair is a character like others
        return markupsafe.Markup("`").join(parts)
    return markupsafe.Markup("").join(
        markupsafe.Markup("<code>{}</code>").format(part) if i % 2 else part for i, part in enumerate(parts)
    )


def _safe(markup: object):
    """Mark HTML that this package made itself as not to be escaped."""
    import markupsafe

    return markupsafe.Markup(markup)
