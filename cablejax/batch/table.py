"""A table that grows by whole scans while a batch runs, as CSV or JSON lines, and can be read back to go on from.

Rows are appended in the order in which they are known and stay where they are until the end, when the table is put in
order in one step. A scan's rows are written together; a scan counts as done where all of them, and the newline behind
them, are there. Rows further down replace those of the same scan further up.
"""

import contextlib
import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

Row = dict[str, Any]


class TableError(Exception):
    """A table cannot be read or written; the message says why."""


class Column(NamedTuple):
    """A column: its name, what stands in it, and its meaning in words."""

    name: str
    kind: Literal["text", "number", "whole", "flag"]
    meaning: str


SCAN: tuple[Column, ...] = (
    Column("file", "text", "name of the scan within the folder"),
    Column("cable", "whole", "number of the cable within the scan, from 1; empty where there is none"),
    Column("cables", "whole", "how many cables the scan has rows for"),
    Column(
        "outcome", "text", "`result`, `no result` (see `error`), `defect` of this program, or `crashed` or too slow"
    ),
)
ABOUT: tuple[Column, ...] = (
    Column("warnings", "text", "what should be known before the numbers are used"),
    Column("error", "text", "why there is no result"),
    Column("bytes", "whole", "size of the file"),
    Column("modified_ns", "whole", "when it was last changed, in ns since 1970"),
    Column("settings", "text", "digest of the options that the result depends on"),
    Column("version", "text", "version of cablejax"),
    Column("schema", "text", "name and version of these columns"),
)


def columns_of(own: Sequence[Column]) -> tuple[Column, ...]:
    """All columns of a command's table."""
    return (*SCAN, *own, *ABOUT)


class Table:
    """Rows of scans on the disk; `known` holds those of complete scans by file.

    Args:
        path: Ending in .csv or .jsonl. An existing one is continued.
        columns: All of them.
        fresh: Begin anew where the file exists.

    Raises:
        TableError: If the file is not such a table, another run is writing it, or it cannot be opened.
    """

    def __init__(self, path: str | Path, columns: Sequence[Column], *, fresh: bool = False):
        self.path, self.columns = Path(path), tuple(columns)
        self.names = [column.name for column in columns]
        self.as_csv = self.path.suffix.lower() == ".csv"
        self.known: dict[str, list[Row]] = {}
        try:
            self._file = self.path.open("a+b")
        except OSError as error:
            raise self._cannot(error) from None
        try:
            self._begin(fresh)
        except OSError as error:
            self.close()
            raise self._cannot(error) from None
        except TableError:
            self.close()
            raise

    def _begin(self, fresh: bool) -> None:
        from cablejax.io.atomic import fcntl, lock  # with jax, which takes long; a command's columns are there at once

        if fcntl is not None and not lock(self._file):
            raise TableError(f"{self.path}: another run is writing it")
        if fresh:
            self._file.truncate(0)
        self._read()

    def _read(self) -> None:
        """Take over what is complete, and cut off half a row that a kill or a full disk has left."""
        self._file.seek(0)
        content = self._file.read()
        if not content:
            if self.as_csv:
                self._file.write(_line(self.names))
                self._file.flush()
            return
        whole = content[: content.rfind(b"\n") + 1]
        rows = self._from_csv(whole) if self.as_csv else self._from_json(whole)
        if len(whole) < len(content):
            self._file.truncate(len(whole))
        for row in rows:
            if row["cable"] in (None, 1):
                self.known[row["file"]] = []
            self.known.setdefault(row["file"], []).append(row)
        self.known = {file: rows for file, rows in self.known.items() if len(rows) == max(1, rows[0]["cables"] or 0)}

    def _from_csv(self, content: bytes) -> list[Row]:
        lines = csv.reader(io.StringIO(content.decode("utf-8", errors="replace"), newline=""))
        if next(lines, None) != self.names:
            raise TableError(
                f"{self.path}: is no table of this command; give another name, or --no-resume to replace it"
            )
        return [row for cells in lines if (row := self._typed(cells)) is not None]

    def _typed(self, cells: list[str]) -> Row | None:
        """A row of a CSV; None where it has been changed so that it cannot be read."""
        if len(cells) != len(self.columns):
            return None
        try:
            return {c.name: _parse(c, cell) for c, cell in zip(self.columns, cells, strict=True)}
        except (ValueError, KeyError):
            return None

    def _from_json(self, content: bytes) -> list[Row]:
        rows: list[Any]
        try:
            rows = [json.loads(line) for line in content.splitlines()]
        except ValueError:
            rows = [None]
        if any(not isinstance(row, dict) or list(row) != self.names for row in rows):
            raise TableError(
                f"{self.path}: is no table of this command; give another name, or --no-resume to replace it"
            )
        return rows

    def add(self, rows: Sequence[Row]) -> None:
        """Append a scan's rows, and hand them to the system.

        Raises:
            TableError: If they cannot be written.
        """
        try:
            self._file.write(b"".join(map(self._encoded, rows)))
            self._file.flush()
        except OSError as error:
            raise self._cannot(error) from None
        self.known[rows[0]["file"]] = list(rows)

    def finish(self, files: Iterable[str]) -> int:
        """Put the rows of some files in that order, in one step, and leave out all others; how many scans those were.

        Raises:
            TableError: If the table cannot be written.
        """
        from cablejax.io import atomic_write

        files = list(files)
        kept = [row for file in files for row in self.known.get(file, [])]
        try:
            with atomic_write(self.path) as file:
                file.write(_line(self.names) if self.as_csv else b"")
                file.write(b"".join(map(self._encoded, kept)))
        except OSError as error:
            raise self._cannot(error) from None
        self.close()
        return len(self.known.keys() - set(files))

    def close(self) -> None:
        """Let another run have it."""
        with contextlib.suppress(OSError):  # what a full disk did not take
            self._file.close()

    def __enter__(self) -> "Table":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _encoded(self, row: Mapping[str, Any]) -> bytes:
        values = [row[name] for name in self.names]
        if self.as_csv:
            return _line(["" if value is None else value for value in values])
        return (json.dumps(dict(zip(self.names, values, strict=True)), allow_nan=False) + "\n").encode()

    def _cannot(self, error: OSError) -> TableError:
        return TableError(f"{self.path}: cannot be written ({error.strerror})")


def _line(values: Sequence[Any]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerow(values)
    return text.getvalue().encode("utf-8", errors="backslashreplace")


def _parse(column: Column, cell: str) -> Any:
    if cell == "":
        return None
    match column.kind:
        case "number":
            return float(cell)
        case "whole":
            return int(cell)
        case "flag":
            return {"True": True, "False": False}[cell]
        case "text":
            return cell
