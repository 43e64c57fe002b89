"""A section of what is told: results files, and the tables and figures made of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from experiments.analysis.benchmark import Benchmark
from experiments.analysis.results import Results
from experiments.display.drawing import Drawing
from experiments.display.table import Table

File = TypeVar("File", Results, Benchmark)
Made = TypeVar("Made", Table, Drawing)


@dataclass(frozen=True)
class Section(Generic[File]):
    """What is shown of one or several files of one kind.

    Attributes:
        kind: `Results` of runs, or `Benchmark`.
        title: Heading.
        text: What the section is about, one paragraph.
        names: The files, by experiment or benchmark; a section is shown where at least one is there.
        tables: Makers of its tables; each takes what was found of `names`, and gives None where it needs more.
        figures: Makers of its figures, likewise.
    """

    kind: type[File]
    title: str
    text: str
    names: tuple[str, ...]
    tables: tuple[Callable[[dict[str, File]], Table | None], ...] = ()
    figures: tuple[Callable[[dict[str, File]], Drawing | None], ...] = ()

    def read(self, folder: Path) -> dict[str, File]:
        """The section's files in a folder, in the order of `names`."""
        found = {name: self.kind.read(folder, name) for name in self.names}
        return {name: file for name, file in found.items() if file is not None}

    def made_tables(self, folder: Path) -> list[Table]:
        """The tables that a results folder allows."""
        found = self.read(folder)
        return [table for maker in self.tables if found and (table := maker(found)) is not None]

    def made_figures(self, folder: Path) -> list[Drawing]:
        """The figures that a results folder allows."""
        found = self.read(folder)
        return [drawing for maker in self.figures if found and (drawing := maker(found)) is not None]


def of(name: str, maker: Callable[[File], Made | None]) -> Callable[[dict[str, File]], Made | None]:
    """A maker that takes a single file, as one of `Section`."""
    return lambda found: maker(found[name]) if name in found else None
