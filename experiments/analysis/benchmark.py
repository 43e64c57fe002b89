"""Files under results/benchmarks/ as tables and figures read them; `benchmarks.record` writes them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cablejax.io import read_json

FOLDER = "benchmarks/"  # begins the names of these files among results


@dataclass(frozen=True)
class BenchmarkTable:
    """One table of a benchmark.

    Attributes:
        title: What was measured; empty where the file's name says it.
        config: What it was measured with.
        rows: One for each thing measured; missing values are left out.
    """

    title: str
    config: dict[str, Any]
    rows: list[dict[str, Any]]


@dataclass(frozen=True)
class Benchmark:
    """One file.

    Attributes:
        tables: By name, in the file's order.
        provenance: As `cablejax.io.provenance` gives it.
    """

    tables: dict[str, BenchmarkTable]
    provenance: dict[str, Any]

    @classmethod
    def read(cls, folder: Path, name: str) -> "Benchmark | None":
        """Read `<folder>/<name>.json`, None where it was not made.

        Raises:
            ValueError: If the file is laid out otherwise, naming what is missing.
        """
        path = folder / f"{name}.json"
        if not path.is_file():
            return None
        raw = read_json(path)
        if not isinstance(raw, dict) or set(raw) != {"tables", "provenance"}:
            keys = ", ".join(raw) if isinstance(raw, dict) else type(raw).__name__
            raise ValueError(f"{path}: expected tables and provenance, as benchmarks.record writes them, got {keys}")
        return cls({key: BenchmarkTable(**table) for key, table in raw["tables"].items()}, raw["provenance"])

    def rows(self, table: str) -> list[dict[str, Any]]:
        """Rows of a table; none where the file has no such table."""
        return self.tables[table].rows if table in self.tables else []

    @property
    def machine(self) -> str:
        """The processor that it ran on, and how many cores were used."""
        cpu = self.provenance["cpu"]
        return f"{cpu['model']}, {cpu['usable']} core{'s' if cpu['usable'] != 1 else ''}"
