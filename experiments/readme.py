"""Put the numbers of results/ into the README, between its markers.

python -m experiments.readme [--check]
"""

import argparse
import re
import sys
from pathlib import Path

from experiments import ROOT
from experiments.display.claims import verdict_table
from experiments.display.sections import all_tables

MARK = re.compile(r"(<!-- results:begin -->\n).*?(<!-- results:end -->)", re.DOTALL)


def fill(text: str, results: Path) -> str:
    """The README's text with every table of a results folder between the markers.

    Raises:
        ValueError: If the markers are not there.
    """
    if not MARK.search(text):
        raise ValueError("README: expected the markers <!-- results:begin --> and <!-- results:end -->")
    claims = verdict_table(results)
    tables = all_tables(results) + ([] if claims is None else [claims])
    blocks = [f"**{table.title}**\n\n{table.to_markdown()}\n\n{table.caption}\n" for table in tables]
    return MARK.sub(lambda match: match[1] + "\n" + "\n".join(blocks) + "\n" + match[2], text)


def main() -> None:
    """Rewrite README.md, or with `--check` say whether it is up to date."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.readme", description="Fill the README's tables from results/."
    )
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 if the README is stale")
    options = parser.parse_args()
    path = ROOT / "README.md"
    old = path.read_text(encoding="utf-8")
    new = fill(old, ROOT / "results")
    if options.check:
        sys.exit(old != new)
    path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
