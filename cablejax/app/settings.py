"""What is chosen on the page, as the arguments of the command that does the same."""

import math
import shlex
from collections.abc import Mapping
from typing import Any

NUMBERS = {"tolerance": 2, "diameter": 2, "box": 6}
NAMES = ("unit", "catalogue", *NUMBERS)


def arguments_of(settings: Mapping[str, Any]) -> list[str]:
    """Options of `cablejax measure`; those that are empty are left out.

    Args:
        settings: `unit`, `catalogue` (texts), `tolerance`, `diameter` (two numbers), `box` (six), each may be None; mm.

    Raises:
        ValueError: If a name is unknown, or a value is no such thing.

    Example:
        >>> arguments_of({"unit": "mm", "tolerance": [34, 34.5], "box": None})
        ['--unit', 'mm', '--tolerance', '34', '34.5']
    """
    given = {name: value for name, value in settings.items() if value is not None}
    for name, value in given.items():
        _check(name, value)
    found = []
    for name in NAMES:
        if name in given:
            values = [_text(x) for x in given[name]] if name in NUMBERS else [given[name]]
            found += [f"--{name}", *values]
    return found


def command_of(name: str, settings: Mapping[str, Any], *, every: bool) -> str:
    """The line for a shell that gives the numbers on the page."""
    found = [*arguments_of(settings), *(["--all"] if every else [])]
    return shlex.join(["cablejax", "measure", *(["--", name] if name.startswith("-") else [name]), *found])


def _check(name: str, value: Any) -> None:
    if name not in NAMES:
        raise ValueError(f"{name}: expected one of {', '.join(NAMES)}")
    if name not in NUMBERS:
        if not isinstance(value, str) or not value or value.startswith("-"):
            raise ValueError(f"{name}: expected a word, got {value!r}")
        return
    count = NUMBERS[name]
    fits = isinstance(value, list) and len(value) == count and all(_is_number(x) for x in value)
    if not fits:
        raise ValueError(f"{name}: expected {count} numbers, got {value!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _text(value: float | int) -> str:
    """Without an exponent, which argparse would take for an option where it is negative."""
    return f"{value:.6f}".rstrip("0").rstrip(".")
