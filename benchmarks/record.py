"""The one layout of the files under results/benchmarks/: tables by name, each with title, configuration and rows."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any


def table(
    rows: Iterable[Mapping[str, Any]], *, title: str = "", config: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A table for `write`: what was measured, with what, and a row for each thing measured."""
    return {"title": title, "config": dict(config or {}), "rows": [dict(row) for row in rows]}


def write(
    path: str | Path,
    tables: Mapping[str, Mapping[str, Any]],
    *,
    seeds: Sequence[int] = (),
    config: Mapping[str, Any] | None = None,
) -> None:
    """Write tables with their provenance, the old file staying until the new one is whole.

    Args:
        path: JSON file; its folder is made where there is none.
        tables: By name, as `table` makes them.
        seeds: Of everything random.
        config: Options of the run.
    """
    from cablejax.io import provenance, write_json

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"tables": dict(tables), "provenance": provenance(seeds=list(seeds), config=dict(config or {}))}
    write_json(path, content)
    print(f"written to {path}")


def earlier_rows(path: str | Path, name: str) -> list[dict[str, Any]]:
    """The rows of a table that an earlier run wrote; none where there is no such file."""
    from cablejax.io import read_json

    return read_json(path)["tables"][name]["rows"] if Path(path).is_file() else []
