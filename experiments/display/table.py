"""A table as text, ready for terminal, README and report."""

from dataclasses import dataclass, field
from html import escape

from experiments.analysis.results import Results

SHORT = 30  # letters that a cell may have and still stand on one line


@dataclass
class Table:
    """Cells as text, ready to print in any form."""

    title: str
    header: list[str]
    rows: list[list[str]]
    caption: str
    groups: list[tuple[str, int]] = field(default_factory=list)

    def to_text(self) -> str:
        """Aligned columns for a terminal."""
        rows = [self.header, *self.rows]
        widths = [max(len(row[i]) for row in rows) for i in range(len(self.header))]
        self._widen(widths)
        lines = [
            "  ".join(
                cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
            for row in rows
        ]
        above = [self._heading(widths)] if self.groups else []
        return "\n".join([self.title, *above, lines[0], "-" * len(lines[0]), *lines[1:], self.caption])

    def _widen(self, widths: list[int]) -> None:
        """Make the last column of each group wide enough for the group's name."""
        end = 0
        for name, span in self.groups:
            end += span
            width = sum(widths[end - span : end]) + 2 * (span - 1)
            widths[end - 1] += max(0, len(name) - width)

    def _heading(self, widths: list[int]) -> str:
        """The groups' names, each over the middle of its columns."""
        parts, start = [], 0
        for name, span in self.groups:
            parts.append(name.center(sum(widths[start : start + span]) + 2 * (span - 1)))
            start += span
        return "  ".join(parts).rstrip()

    def to_markdown(self) -> str:
        """A table for README and docs."""
        above = [name for name, span in self.groups for _ in range(span)] or [""] * len(self.header)
        header = [f"{group}: {name}" if group else name for group, name in zip(above, self.header, strict=True)]
        rule = ["---", *["---:" if self._numeric(i) else "---" for i in range(1, len(self.header))]]
        return "\n".join("| " + " | ".join(row) + " |" for row in [header, rule, *self.rows])

    def to_html(self) -> str:
        """A table for notebooks, with the groups' names over their columns."""
        side = ["left", *["right" if self._numeric(i) else "left" for i in range(1, len(self.header))]]
        above = "".join(
            f'<th colspan="{span}" style="text-align: center">{escape(name)}</th>' for name, span in self.groups
        )
        lines = [f"<tr>{above}</tr>"] if self.groups else []
        for tag, row in [("th", self.header), *(("td", row) for row in self.rows)]:
            cells = [_cell(tag, text, at) for text, at in zip(row, side, strict=True)]
            lines.append(f"<tr>{''.join(cells)}</tr>")
        return "<table>\n" + "\n".join(lines) + "\n</table>"

    def _numeric(self, column: int) -> bool:
        """Whether a column holds short cells, which are set to the right; sentences are not."""
        return all(len(row[column]) < 40 for row in self.rows)


def _cell(tag: str, text: str, side: str) -> str:
    """One cell of an HTML table; a number keeps its interval on its own line."""
    whole = "; white-space: nowrap" if tag == "td" and len(text) <= SHORT else ""
    return f'<{tag} style="text-align: {side}{whole}">{escape(text)}</{tag}>'


def told(results: Results) -> str:
    """The size of a result's runs and their seeds, as captions say it."""
    seeds = len(results.seeds)
    return f"size {results.size}, {seeds} seed{'s' if seeds > 1 else ''}{', mean ± 95 % interval' if seeds > 1 else ''}"


def schedule(results: Results) -> str:
    """The schedule of the learning rate, as captions say it; results from before it could be chosen had none."""
    name = results.shared.get("training.schedule", "constant")
    return "a constant rate" if name == "constant" else f"a rate that falls to 0 along half a {name}"
