"""`cablejax report`: a scan measured and its report written, in one step."""

import argparse
from typing import Any

from cablejax.cli import measure


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Measure, with the report as the output."""
    return measure.run(options)


table = measure.table
