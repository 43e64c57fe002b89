"""Put what results/ says into the README and the pages of docs/, between their markers.

python -m experiments.readme [--check]
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

from experiments import ROOT
from experiments.display.claims import verdict_table
from experiments.display.headlines import headline_table
from experiments.display.section import Section
from experiments.display.sections import SHOWN
from experiments.display.table import Table

PAGES = ("README.md", "docs/results.md", "docs/nets.md", "docs/learned.md")
MARK = re.compile(r"(<!-- made: ([^\n]+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def sections(results: Path) -> str:
    """Every section with its files and tables."""
    told = [_section(section, results) for section in SHOWN]
    return "\n".join(text for text in told if text)


def _section(section: Section, results: Path) -> str:
    tables = section.made_tables(results)
    if not tables:
        return ""
    files = ", ".join(f"`results/{name}.json`" for name in section.read(results))
    return "\n".join([f"## {section.title}\n", f"{section.text}\n", f"From {files}.\n", *map(_headed, tables)])


def _headed(table: Table) -> str:
    return f"### {table.title}\n\n{table.to_markdown()}\n\n{table.caption}\n"


def claims(results: Path) -> str:
    """The paper's claims, what was found and the verdict."""
    table = verdict_table(results)
    return "" if table is None else f"{table.to_markdown()}\n\n{table.caption}\n"


def verdicts(results: Path) -> str:
    """The paper's claims and the verdict alone."""
    table = verdict_table(results)
    if table is None:
        return ""
    rows = [[_without_brackets(claim), verdict] for claim, _, verdict in table.rows]
    return Table("", ["Claim", "Verdict"], rows, "").to_markdown() + "\n"


def _without_brackets(claim: str) -> str:
    return re.sub(r" \([^()]*\)", "", claim)


def headlines(results: Path) -> str:
    """Three rows."""
    table = headline_table(results)
    return "" if table is None else table.to_markdown() + "\n"


BLOCKS: dict[str, Callable[[Path], str]] = {
    "sections": sections,
    "claims": claims,
    "verdicts": verdicts,
    "headlines": headlines,
}


def block(name: str, results: Path) -> str:
    """What stands between the markers of a name: one of `BLOCKS`, or the table of that title.

    Raises:
        ValueError: If there is neither.
    """
    if name in BLOCKS:
        return BLOCKS[name](results)
    for section in SHOWN:
        for table in section.made_tables(results):
            if table.title == name:
                return f"{table.to_markdown()}\n\n{table.caption}\n"
    raise ValueError(f"made: {name}: expected one of {', '.join(BLOCKS)} or the title of a table that results/ allows")


def fill(text: str, results: Path) -> str:
    """A page's text with what a results folder says between its markers, `<!-- made: NAME -->` and `<!-- end -->`.

    Raises:
        ValueError: If there are no markers, or nothing is called by the name of one.
    """
    if not MARK.search(text):
        raise ValueError("expected the markers <!-- made: NAME --> and <!-- end -->")
    return MARK.sub(lambda match: f"{match[1]}\n{block(match[2], results)}\n{match[3]}", text)


def main() -> None:
    """Rewrite the pages, or with `--check` say which are not up to date."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.readme", description="Fill the README's and the pages' tables from results/."
    )
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 if a page is stale")
    options = parser.parse_args()
    stale = []
    for path in (ROOT / page for page in PAGES):
        old = path.read_text(encoding="utf-8")
        new = fill(old, ROOT / "results")
        if new != old:
            stale.append(str(path.relative_to(ROOT)))
            if not options.check:
                path.write_text(new, encoding="utf-8")
    print("\n".join(stale))
    sys.exit(options.check and bool(stale))


if __name__ == "__main__":
    main()
