"""Print the tables of a results folder: ours beside the paper's.

python -m experiments.tables --results results            every table
python -m experiments.tables --results results --paper    Tables 1-3 in the paper's own layout
"""

import argparse
from pathlib import Path

from experiments.display.filtering.paper_layout import paper_tables
from experiments.display.sections import all_tables


def main() -> None:
    """Print every table that can be made."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.tables", description="Print tables from results files."
    )
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--paper", action="store_true", help="Tables 1-3 alone, in the paper's own layout")
    options = parser.parse_args()
    tables = paper_tables(options.results) if options.paper else all_tables(options.results)
    print("\n\n".join(table.to_text() for table in tables))


if __name__ == "__main__":
    main()
