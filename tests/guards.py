"""Tests that cannot fail: switch off each guard of `cablejax/` in turn and see whether a test goes red.

A guard is a `raise` statement. After each test, the test runs again once for every guard that it reached, with that guard
passed over; a guard that no test misses is unguarded. Verdicts are kept in `.pytest_cache/guards.json`, so that a run that
was stopped goes on, and are asked anew where the statement or its function changed.

    python -m tests.guards tests/io             the guards that these tests reach, and those of cablejax/io that they do not
    python -m tests.guards tests/io --anew      forget the verdicts first
"""

import ast
import builtins
import json
import signal
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "cablejax"
STATE = ROOT / ".pytest_cache" / "guards.json"
SECONDS = 120  # without its guard a loop may never end
CALL = "__guard__"
SPARED = "cablejax/io/atomic.py"  # without its guards a test that runs as root puts a file in the place of /dev/full


def guards_of(path: Path) -> dict[str, ast.Raise]:
    """The `raise` statements of a file by name: file, function, what is raised, its number among equals."""
    found: dict[str, ast.Raise] = {}
    if path == ROOT / SPARED:
        return found

    def visit(node: ast.AST, owner: str) -> None:
        for child in ast.iter_child_nodes(node):
            inner = isinstance(child, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef)
            if isinstance(child, ast.Raise) and child.exc is not None:
                name = f"{path.relative_to(ROOT)}::{owner}: {ast.unparse(child)}"
                number = sum(each.startswith(name) for each in found)
                found[f"{name} [{number}]"] = child
            visit(child, f"{owner}.{child.name}".lstrip(".") if inner else owner)

    visit(ast.parse(path.read_text()), "")
    return found


def with_switches(path: Path) -> bytes:
    """The file's text with each `raise` made `if __guard__(name): raise`; no line moves."""
    lines = path.read_bytes().splitlines(keepends=True)
    for name, node in guards_of(path).items():
        line = lines[node.lineno - 1]
        switch = f"if {CALL}({name!r}): ".encode()
        lines[node.lineno - 1] = line[: node.col_offset] + switch + line[node.col_offset :]
    return b"".join(lines)


class Guards:
    """The pytest plugin: which guards a test reaches, and whether it goes red without each."""

    def __init__(self, verdicts: dict[str, str]) -> None:
        self.verdicts = verdicts
        self.reached: set[str] = set()
        self.off: str | None = None

    def guard(self, name: str) -> bool:
        """Whether the guard is on; notes that it was reached."""
        self.reached.add(name)
        return name != self.off

    def install(self) -> None:
        """Load every module of `cablejax` with switches, also through loaders that rewrite it further (jaxtyping)."""
        setattr(builtins, CALL, self.guard)
        plain = SourceFileLoader.get_data

        def get_data(loader, path):
            place = Path(path)
            if SOURCES not in place.resolve().parents:
                return plain(loader, path)
            if place.suffix != ".py":
                raise OSError("no bytecode: it has no switches")
            return with_switches(place.resolve())

        SourceFileLoader.get_data = get_data
        sys.dont_write_bytecode = True

    def pytest_runtest_protocol(self, item, nextitem) -> bool:
        """Run the test, then again without each guard that it reached and that no test has missed yet."""
        self.reached, self.off = set(), None
        reports = run(item, log=True)
        if all(report.passed for report in reports):
            for name in sorted(name for name in self.reached if self.verdicts.get(name) in (None, "unguarded")):
                self.off = name
                red = any(report.failed for report in run(item, log=False))
                self.off = None
                self.verdicts[name] = item.nodeid if red else "unguarded"
                forget_programs()
                STATE.parent.mkdir(exist_ok=True)
                others = json.loads(STATE.read_text()) if STATE.exists() else {}  # of another run beside this one
                STATE.write_text(json.dumps(others | self.verdicts, indent=1))
        item.session._setupstate.teardown_exact(nextitem)
        return True


class _Sibling:
    """Stands for another test of the same module: fixtures of the module and the session stay."""

    def __init__(self, item) -> None:
        self.item = item

    def listchain(self):
        return self.item.listchain()[:-1]


def run(item, *, log: bool):
    """One run of a test with fresh fixtures of its own; without `log` nothing is reported."""
    from _pytest.runner import runtestprotocol

    def late(*_):
        raise TimeoutError(f"no end in {SECONDS} s")

    item._initrequest() if hasattr(item, "_initrequest") else None
    if log:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    previous = signal.signal(signal.SIGALRM, late)
    signal.alarm(0 if log else SECONDS)
    try:
        return runtestprotocol(item, log=log, nextitem=_Sibling(item))
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


def forget_programs() -> None:
    """A program traced while a guard was off would never ask that guard again."""
    import jax

    jax.clear_caches()


def main(arguments: list[str]) -> int:
    """Judge the guards that the given tests reach; 1 where one is unguarded or, in their part, never reached."""
    import pytest

    if "--anew" in arguments:
        arguments.remove("--anew")
        STATE.unlink(missing_ok=True)
    known = {name for path in sorted(SOURCES.rglob("*.py")) for name in guards_of(path)}
    old = json.loads(STATE.read_text()) if STATE.exists() else {}
    plugin = Guards({name: verdict for name, verdict in old.items() if name in known})
    plugin.install()
    pytest.main(["-q", *arguments], plugins=[plugin])
    parts = tuple(f"cablejax/{Path(each.split('::')[0]).relative_to('tests').parts[0]}/" for each in arguments
                  if each.startswith("tests/"))  # fmt: skip
    unguarded = sorted(name for name, verdict in plugin.verdicts.items() if verdict == "unguarded")
    unreached = sorted(name for name in known - plugin.verdicts.keys() if name.startswith(parts or "cablejax/"))
    print(f"\n{len(plugin.verdicts) - len(unguarded)} guards of {len(known)} missed by a test when off")
    for title, names in (("reached, and no test goes red without it", unguarded), ("reached by no test", unreached)):
        print(f"{len(names)} {title}" + "".join(f"\n  {name}" for name in names))
    return bool(unguarded or unreached)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
