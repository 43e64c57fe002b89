"""A command over a folder of scans: a row a scan, in tables that grow while it runs and from which it goes on."""

import argparse
import contextlib
import hashlib
import importlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablejax import __version__
from cablejax.cli.checkpoint import LABELLER_CARD
from cablejax.cli.errors import NoResultError
from cablejax.cli.progress import Progress
from cablejax.cli.scans import check_output, make_folder, rows, say
from cablejax.cli.streams import warnings_told
from cablejax.optional import MissingPackageError

if TYPE_CHECKING:
    from cablejax.batch import Column, Outcome, Row, Table, Task

FINAL = ("result", "no result")  # outcomes that another run would not change
# What a result does not depend on.
NEUTRAL = (
    "command", "scan", "json", "quiet", "csv", "jsonl", "jobs", "scheduler", "resume", "time_limit", "report", "output", "export",
    "plan", "pattern", "chart",
)  # fmt: skip
SHOWN = 50  # scans that a summary lists one by one

Places = Mapping[str, Callable[[Path], Path]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that a command has for folders."""
    group = parser.add_argument_group("for a folder of scans")
    group.add_argument(
        "--csv", metavar="FILE.csv", help="one row a scan, written as it is known; the next run goes on from it"
    )
    group.add_argument("--jsonl", metavar="FILE.jsonl", help="the same rows as JSON lines")
    group.add_argument("--jobs", type=int, metavar="N", help="processes (default: one a core; 0: none but this one)")
    group.add_argument("--scheduler", metavar="ADDRESS", help="work on a Dask cluster: tcp://10.0.0.1:8786")
    group.add_argument(
        "--time-limit", type=float, metavar="S", help="seconds after which a scan is given up (default: none)"
    )
    group.add_argument(
        "--resume", action=argparse.BooleanOptionalAction, default=True,
        help="pass over scans that the table holds, if file, options and version are the same (default)",
    )  # fmt: skip


def refuse_options(options: argparse.Namespace, *names: str) -> None:
    """For one scan: there is no table.

    Raises:
        NoResultError: If one is asked for.
    """
    for name in names or ("csv", "jsonl", "scheduler"):
        if getattr(options, name, None) is not None:
            raise NoResultError(f"--{name}: is for a folder of scans; give --json for one")


def run_folder(options: argparse.Namespace, places: Places | None = None) -> dict[str, Any]:
    """Run a command on every point file of the folder `options.scan`.

    Its module has `COLUMNS` and `SCHEMA`, those of its rows; `one(options)`, the result for a scan; and `rows_of(result)`.

    Args:
        options: Of the command.
        places: For each option that names an output, the file for a scan; its folder is made.

    Raises:
        NoResultError: If the folder holds no point file, none of them gives a result, or a table cannot be written.
    """
    from cablejax.batch import EngineError, TableError, engine_for

    if options.time_limit is not None and not options.time_limit > 0:
        raise NoResultError(f"--time-limit: expected more than 0 s, got {options.time_limit:g}")
    module = importlib.import_module(f"cablejax.cli.{options.command}")
    folder, tables = Path(options.scan), [path for path in (options.csv, options.jsonl) if path is not None]
    for path, ending in ((options.csv, ".csv"), (options.jsonl, ".jsonl")):
        if path is not None:
            check_output(path, (ending,))
    files = _scans(folder, tables)
    places = places or {}
    try:
        engine = engine_for(jobs=options.jobs, scheduler=options.scheduler)
    except ValueError as error:
        raise NoResultError(f"--{error}") from None
    try:
        with contextlib.closing(engine), _tables(tables, module, fresh=not options.resume) as opened:
            batch = _Batch(options, module.SCHEMA, module.COLUMNS, files, opened, places)
            for place in places.values():
                make_folder(place(files[0]).parent)
            batch.run(engine)
            return batch.summary()
    except (TableError, EngineError) as error:
        raise NoResultError(str(error)) from None


def _scans(folder: Path, tables: Sequence[str]) -> list[Path]:
    """The point files of a folder, by name.

    Raises:
        NoResultError: If there is none.
    """
    from cablejax.io import READABLE

    own = {Path(path).resolve() for path in tables}
    files = sorted(path for path in folder.iterdir() if _is_scan(path) and path.resolve() not in own)
    if not files:
        raise NoResultError(f"{folder}: is a folder without point files ({', '.join(READABLE)}, each also with .gz)")
    return files


def _is_scan(path: Path) -> bool:
    """Whether a file is taken for a scan: by its ending, unless it is hidden or a table that a batch wrote."""
    from cablejax.io import READABLE

    endings = [ending.lower() for ending in path.suffixes]
    packed = endings[-1:] == [".gz"]
    ending = endings[-2:-1] if packed else endings[-1:]
    known = not ending if packed and len(endings) == 1 else bool(ending) and ending[0] in READABLE
    return known and not path.name.startswith(".") and path.is_file() and not _is_table(path)


def _is_table(path: Path) -> bool:
    from cablejax.batch.table import SCAN

    try:
        with path.open("rb") as file:
            return file.readline(200).startswith(",".join(column.name for column in SCAN).encode() + b",")
    except OSError:
        return False


@contextmanager
def _tables(paths: Sequence[str], module: Any, *, fresh: bool) -> "Iterator[list[Table]]":
    """The tables, open for writing by this run alone."""
    from cablejax.batch import Table, columns_of

    with ExitStack() as stack:
        yield [stack.enter_context(Table(path, columns_of(module.COLUMNS), fresh=fresh)) for path in paths]


class _Batch:
    """A run over the scans of a folder: which are to do, and the rows of those done."""

    def __init__(
        self, options: argparse.Namespace, schema: str, columns: "Sequence[Column]", files: list[Path],
        tables: "list[Table]", places: Places,
    ):  # fmt: skip
        self.options, self.schema, self.columns, self.tables, self.places = options, schema, columns, tables, places
        self.settings = _digest(options)
        self.about: dict[str, Row] = {_text(path.name): self._about(path) for path in files}
        self.files = {_text(path.name): path for path in files}
        self.rows: dict[str, list[Row]] = {}

    def _about(self, path: Path) -> "Row":
        """What a row says of its origin."""
        status = path.stat()
        return {
            "bytes": status.st_size, "modified_ns": status.st_mtime_ns, "settings": self.settings,
            "version": __version__, "schema": self.schema,
        }  # fmt: skip

    def run(self, engine: Any) -> None:
        """Do what is to do, and put the tables in order."""
        self._take_over()
        tasks = [self._task(name, path) for name, path in self.files.items() if name not in self.rows]
        if self.rows:
            say(self.options, f"{len(self.rows)} of {len(self.files)} scans are done already")
        progress = Progress(self.options, len(tasks))
        outcomes = engine.run(tasks)
        try:
            for outcome in outcomes:
                found = self._rows(outcome)
                self.rows[outcome.name] = found
                for table in self.tables:
                    table.add(found)
                progress.step(f"{outcome.name}: {found[0]['outcome']}")
        finally:
            progress.close()
            outcomes.close()
        for table in self.tables:
            left = table.finish(self.files)
            if left:
                say(self.options, f"{table.path}: rows of {left} files that are no longer there are left out")

    def _take_over(self) -> None:
        """Rows of scans that another run would not change, from any of the tables into all of them."""
        for table in self.tables:
            for name, found in table.known.items():
                if self._still_true(name, found):
                    self.rows.setdefault(name, found)
        for table in self.tables:
            for name, found in self.rows.items():
                if table.known.get(name) != found:
                    table.add(found)

    def _still_true(self, name: str, found: "list[Row]") -> bool:
        path, about = self.files.get(name), self.about.get(name)
        if path is None or about is None or found[0]["outcome"] not in FINAL:
            return False
        same = all(row[key] == value for row in found for key, value in about.items())
        return same and (found[0]["outcome"] != "result" or all(place(path).exists() for place in self.places.values()))

    def _task(self, name: str, path: Path) -> "Task":
        from cablejax.batch import Task

        chosen = {option: str(place(path)) for option, place in self.places.items()}
        for_one = {"scan": str(path), "quiet": True, "csv": None, "jsonl": None, "jobs": 0, "scheduler": None}
        given = vars(self.options) | for_one | chosen
        return Task(name, f"{__name__}:scan_task", {"options": given}, str(Path.cwd()), self.options.time_limit)

    def _rows(self, outcome: "Outcome") -> "list[Row]":
        """A scan's rows, all columns filled."""
        value = outcome.value or {}
        kind = {"returned": value.get("outcome"), "raised": "defect", "crashed": "crashed"}[outcome.kind]
        error = value.get("error")
        if outcome.kind == "raised":
            error = f"a defect of this program, please report it: {outcome.reason}"
        elif outcome.kind == "crashed":
            error = outcome.reason
        cables = value.get("rows", [])
        same = {"file": outcome.name, "cables": len(cables), "outcome": kind, "error": _clean(error)}
        same |= {"warnings": _clean(" ".join(value.get("warnings", []))), **self.about[outcome.name]}
        empty = {column.name: None for column in self.columns}
        numbered = [{"cable": number, **cable} for number, cable in enumerate(cables, 1)] or [{"cable": None}]
        for one in numbered:
            one["warnings"] = _clean(" ".join(filter(None, [same["warnings"], one.get("warnings")])))
        return [empty | same | {name: _clean(cell) for name, cell in one.items()} for one in numbered]

    def summary(self) -> dict[str, Any]:
        """Counts, reasons and rows.

        Raises:
            NoResultError: If no scan gave a result.
        """
        firsts = [self.rows[name][0] for name in self.files]
        if not any(row["outcome"] == "result" for row in firsts):
            raise NoResultError(
                f"{self.options.scan}: none of {len(firsts)} files gave a result; the first: "
                f"{firsts[0]['file']}: {firsts[0]['error']}"
            )
        return {
            "command": self.options.command,
            "folder": self.options.scan,
            "csv": self.options.csv,
            "jsonl": self.options.jsonl,
            "counts": dict(Counter(row["outcome"] for row in firsts)),
            "reasons": _reasons(firsts),
            "rows": [row for name in self.files for row in self.rows[name]],
        }


def _reasons(firsts: "Sequence[Row]") -> list[dict[str, Any]]:
    """Why scans have no result: alike where they differ in numbers alone, the most frequent first."""
    alike: dict[tuple[str, str], list[Row]] = {}
    for row in firsts:
        if row["error"] is not None:
            alike.setdefault((row["outcome"], re.sub(r"\d[\d.,]*", "#", row["error"])), []).append(row)
    ordered = sorted(alike.items(), key=lambda item: -len(item[1]))
    return [
        {"outcome": kind, "count": len(found), "first": found[0]["file"], "error": found[0]["error"]}
        for (kind, _), found in ordered
    ]


def _digest(options: argparse.Namespace) -> str:
    """Of the options that a result depends on, the weights of a network among them."""
    given = {name: value for name, value in vars(options).items() if name not in NEUTRAL}
    if given.get("checkpoint") is not None:
        record = Path(given["checkpoint"]) / "run.json"
        given["run"] = hashlib.sha256(record.read_bytes()).hexdigest() if record.is_file() else None
    elif given.get("labels", "off") != "off":
        given["labeller"] = hashlib.sha256((files("cablejax") / LABELLER_CARD).read_bytes()).hexdigest()
    return hashlib.sha256(json.dumps([options.command, given], sort_keys=True).encode()).hexdigest()[:12]


def _text(name: str) -> str:
    """A file name as text on one line: what UTF-8 cannot say, and line breaks, are escaped."""
    return _clean(name.encode("utf-8", errors="backslashreplace").decode()) or ""


def _clean(value: Any) -> Any:
    """A cell: text on one line, and None for none."""
    if not isinstance(value, str):
        return value
    return value.replace("\r", "\\r").replace("\n", "\\n").encode("utf-8", "backslashreplace").decode() or None


def scan_task(options: dict[str, Any]) -> dict[str, Any]:
    """A command on one scan, called in a process of its own: `outcome`, `error`, `warnings` and `rows`."""
    module = importlib.import_module(f"cablejax.cli.{options['command']}")
    answer: dict[str, Any] = {"outcome": "result", "error": None, "rows": []}
    with warnings_told() as told:
        try:
            answer["rows"] = module.rows_of(module.one(argparse.Namespace(**options)))
        except (NoResultError, MissingPackageError) as error:
            answer |= {"outcome": "no result", "error": str(error).removeprefix(f"{options['scan']}: ")}
    return answer | {"warnings": told}


def table(result: dict[str, Any], line: Callable[[dict[str, Any]], str]) -> str:
    """A summary for reading: a line a cable for a few scans, and the reasons where there are many.

    Args:
        result: Of `run_folder`.
        line: What a row with a result says.
    """
    found = result["rows"]
    parts = [result["folder"]]
    if len(found) <= SHOWN:
        parts.append(rows([(_name(row), line(row) if row["error"] is None else _failure(row)) for row in found]))
    parts += ["", rows([(kind, f"{count:,}") for kind, count in result["counts"].items()])]
    if len(found) > SHOWN and result["reasons"]:
        parts += ["", rows([(f"{one['count']:,} x", f"{one['error']} ({one['first']})") for one in result["reasons"]])]
    parts += [f"  written: {path}" for path in (result["csv"], result["jsonl"]) if path is not None]
    return "\n".join(parts)


def _name(row: dict[str, Any]) -> str:
    return row["file"] if (row["cables"] or 0) < 2 else f"{row['file']}, cable {row['cable']}"


def _failure(row: dict[str, Any]) -> str:
    return f"{row['outcome']}: {row['error']}"
