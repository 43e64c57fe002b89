"""`cablejax report`: `cablejax measure` whose report is an argument."""

import argparse

from cablejax.cli import exports, measure
from cablejax.cli.arguments import add_scan

HELP = "measure a scan and write its self-contained HTML report"
run, table = measure.run, measure.table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_scan(parser)
    parser.add_argument("report", metavar="report.html", help="file to write")
    parser.set_defaults(csv=None, jsonl=None, scheduler=None, all=False, expect=None, picture=None)
    exports.add_arguments(parser)
    measure.add_options(parser)
