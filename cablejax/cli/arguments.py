"""Arguments that several commands have."""

import argparse

UNITS = ("um", "mm", "cm", "dm", "m", "km", "in", "ft")


def add_scan(parser: argparse.ArgumentParser) -> None:
    """The scan, its unit and its columns."""
    parser.add_argument(
        "scan",
        help="point file, or for info, measure and denoise a folder of them: PLY, PCD, XYZ, TXT, CSV, PTS, PTX, OBJ, LAS, LAZ "
        "or E57, gzipped or not",
    )
    parser.add_argument(
        "--unit", choices=UNITS, help="unit of the file's coordinates (default: mm or m by the extent, with a warning)"
    )
    add_columns(parser)


def add_columns(parser: argparse.ArgumentParser) -> None:
    """What the columns of a text table are."""
    parser.add_argument(
        "--columns", metavar="NAMES", help="what the columns of a text table are, such as index,x,y,z,intensity"
    )


def add_output(parser: argparse.ArgumentParser) -> None:
    """How every command says what it found, and what it is at."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON instead of a table")
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")
