"""The public names of cablejax: those in the `__all__` of the package or of a subpackage, and where each is documented."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cache
from types import GenericAlias
from typing import Any

PACKAGE = "cablejax"


def packages() -> list[str]:
    """Dotted names of the package and its subpackages that state what is public in an `__all__`."""
    root = importlib.import_module(PACKAGE)
    found = [PACKAGE, *(each.name for each in pkgutil.walk_packages(root.__path__, f"{PACKAGE}.") if each.ispkg)]
    return [name for name in found if hasattr(importlib.import_module(name), "__all__")]


def public_names() -> dict[str, list[str]]:
    """Names of each package's `__all__`, by package."""
    return {package: list(importlib.import_module(package).__all__) for package in packages()}


@cache
def homes() -> dict[str, str]:
    """Where an object is documented, by where it is defined: `cablejax.ops.neighbors.knn.knn` is `cablejax.ops.knn`.

    Of several packages that export one object the shortest name is taken.
    """
    pairs = sorted(flat(), key=lambda pair: -len(pair[0]))
    return {_definition(*pair): ".".join(pair) for pair in pairs}


def flat() -> Iterator[tuple[str, str]]:
    """Package and name of every public name."""
    for package, names in public_names().items():
        for name in names:
            yield package, name


def home(package: str, name: str) -> str:
    """The page of a name that a package exports: of the shortest of the packages that export the object."""
    return homes().get(_definition(package, name), f"{package}.{name}")


def _definition(package: str, name: str) -> str:
    item = getattr(importlib.import_module(package), name)
    return (
        f"{item.__module__}.{item.__qualname__}" if inspect.isclass(item) or _is_function(item) else f"{package}.{name}"
    )


@cache
def kinds() -> dict[str, dict[str, list[str]]]:
    """For each package its names by kind, in order; under `elsewhere` the full names of what another package documents."""
    return {package: _by_kind(package, names) for package, names in public_names().items()}


def _by_kind(package: str, names: list[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {kind: [] for kind in ("Functions", "Classes", "Errors", "Constants", "elsewhere")}
    for name in names:
        item = getattr(importlib.import_module(package), name)
        if home(package, name) != f"{package}.{name}":
            found["elsewhere"].append(home(package, name))
        elif inspect.isclass(item):
            found["Errors" if issubclass(item, Exception) else "Classes"].append(name)
        else:
            found["Functions" if _is_function(item) else "Constants"].append(name)
    return {kind: sorted(each, key=str.lower) for kind, each in found.items()}


def _is_function(item: Any) -> bool:
    """Functions, and what wraps one with a gradient of its own; no alias of a type."""
    return hasattr(item, "__qualname__") and callable(item) and not isinstance(item, GenericAlias)


def functions() -> set[str]:
    """Full names of the public functions."""
    return {f"{package}.{name}" for package, found in kinds().items() for name in found["Functions"]}


@cache
def short_names() -> dict[str, str]:
    """Full name by what inline code may say: every full name, and a bare one that means a single object."""
    full = {f"{package}.{name}": home(package, name) for package, name in flat()}
    bare: dict[str, set[str]] = {}
    for name, page in full.items():
        bare.setdefault(name.rpartition(".")[2], set()).add(page)
    single = {name: min(pages) for name, pages in bare.items() if len(pages) == 1}
    return {name: name for name in packages() if name != PACKAGE} | full | single
