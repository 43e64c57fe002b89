"""What `--json` prints: each layout with a name, a version, and a JSON Schema (`cablejax schema NAME`)."""

import argparse
import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "schemas"
# A version changes when a field goes, or changes its name, type or meaning; a field that is added changes it as well, for
# the schemas allow no others.
VERSIONS = {
    "measure": 3, "measure-all": 3, "info": 1,
    "denoise": 1, "register": 1, "register-stations": 1, "classify": 1, "simulate": 1, "gage": 1, "app": 1,
    "folder": 1, "schema": 1, "completion": 1,
}  # fmt: skip


HELP = "the JSON Schema of what a command prints with --json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("name", choices=VERSIONS, metavar="name", help=", ".join(VERSIONS))


def layout_of(command: str, result: dict[str, Any]) -> str:
    """The name of a result's layout: the command's own but for a few."""
    if "reasons" in result:
        return "folder"
    if "not_measured" in result:
        return "measure-all"
    if "T_last_file" in result:
        return "register-stations"
    return "measure" if command == "report" else command


def as_json(command: str, result: dict[str, Any]) -> str:
    """A result as JSON text, with `schema` first."""
    name = layout_of(command, result)
    return json.dumps({"schema": f"{name}/{VERSIONS[name]}", **result}, indent=2, allow_nan=False)


def read_schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a layout."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def run(options: argparse.Namespace) -> dict[str, Any]:
    """The schema that was asked for."""
    return {"name": options.name, "json_schema": read_schema(options.name)}


def table(result: dict[str, Any]) -> str:
    """The schema alone."""
    return json.dumps(result["json_schema"], indent=1, ensure_ascii=False)
