"""Keys of the configuration that nothing reads: refused by name, however they were brought in."""

import difflib
import re
from dataclasses import fields, is_dataclass

from omegaconf import DictConfig, OmegaConf

from experiments.harness import schema

MISTYPED = re.compile(r"Could not override '(?P<key>[^']+)'.*Key '(?P<part>[^']+)' not in '(?P<node>\w+)'", re.DOTALL)
ADVICE = re.compile(r"To append to your [\w ]+ use \S+\s*")  # Hydra's, by which a mistyped key would be taken


def check_keys(composed: DictConfig, prefix: str = "") -> None:
    """Refuse keys that are not in the schema (`+key=value` adds them), and keys of it that were taken away (`~key`).

    Dictionaries of options (`model.options`, `optimizer.options`) are passed over: who takes them knows their names.

    Raises:
        ValueError: Naming the key and those that there are.
    """
    node = OmegaConf.get_type(composed)
    if not is_dataclass(node):
        return
    known = [each.name for each in fields(node)]
    for key in composed:
        if key not in known:
            raise ValueError(unknown(f"{prefix}{key}", known))
    for key in known:
        if key not in composed:
            raise ValueError(f"{prefix}{key}: expected this key to stay, got it taken away")
        inner = None if OmegaConf.is_missing(composed, key) else composed[key]
        if isinstance(inner, DictConfig):
            check_keys(inner, f"{prefix}{key}.")


def unknown(key: str, known: list[str]) -> str:
    """What is said of a key that is not there."""
    last = key.rpartition(".")[2]
    near = difflib.get_close_matches(last, known, n=1)
    return (
        f"{key}: unknown key; "
        + (f"did you mean {near[0]}? " if near else "")
        + f"There are {', '.join(sorted(known))}"
    )


def without_advice(text: str) -> str:
    """Hydra's words on a mistyped key with the keys that there are in place of its advice to add it.

    Example:
        >>> without_advice("Could not override 'sed'. To append to your config use +sed=1. Key 'sed' not in 'Config'")[:46]
        'sed: unknown key; did you mean seed? There are'
    """
    found = MISTYPED.search(text)
    node = None if found is None else getattr(schema, found["node"], None)
    if found is None or not is_dataclass(node):
        return ADVICE.sub("", text)
    start = found["key"].partition(found["part"])[0]
    return unknown(start + found["part"], [each.name for each in fields(node)])
