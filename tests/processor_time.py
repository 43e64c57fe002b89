"""What each test costs: `python -m pytest -n 2 -p tests.processor_time --processor-time runs/tests.jsonl`.

Processor seconds, those of child processes that were waited for included, which other work on the machine disturbs less
than it does the time on the clock; and how many functions were traced and programs compiled meanwhile, with their
seconds. A test that makes a shared fixture bears its cost. Printed by folder, by file and by test, dearest first.
"""

import json
import os
import resource
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

LISTED = 40
EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "traced",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowered",
    "/jax/core/compile/backend_compile_duration": "compiled",
}
counts: Counter[str] = Counter()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The file to write."""
    parser.addoption("--processor-time", metavar="FILE", help="write what each test costs to FILE, a JSON line each")


def _on_event(event: str, seconds: float, **_: str | int) -> None:
    if name := EVENTS.get(event):
        counts[name] += 1
        counts[f"{name}_s"] += seconds


def _now() -> dict[str, float]:
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "seconds": own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime,
        "children": children.ru_utime + children.ru_stime,
        **counts,
    }


def _write(config: pytest.Config, test: str, since: dict[str, float]) -> None:
    now = _now()
    row = {"test": test, "worker": os.environ.get("PYTEST_XDIST_WORKER", "")}
    row |= {name: round(value - since.get(name, 0), 4) for name, value in now.items()}
    with Path(config.getoption("--processor-time")).open("a") as file:
        file.write(json.dumps(row) + "\n")


def pytest_configure(config: pytest.Config) -> None:
    """Begin an empty file, and listen to jax."""
    if not (path := config.getoption("--processor-time")):
        return
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        import jax

        jax.monitoring.register_event_duration_secs_listener(_on_event)
    if not hasattr(config, "workerinput"):
        Path(path).write_text("")


def pytest_collection_finish(session: pytest.Session) -> None:
    """The cost of collecting, which each process has for itself."""
    if session.config.getoption("--processor-time") and session.items:
        _write(session.config, "collecting", {})


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Measure one test with its set-up."""
    before = _now()
    try:
        return (yield)
    finally:
        if item.config.getoption("--processor-time"):
            _write(item.config, item.nodeid, before)


def _table(title: str, groups: dict[str, Counter[str]], listed: int) -> Iterator[str]:
    yield f"{title:<76} {'seconds':>8} {'children':>8} {'traced':>13} {'lowered':>13} {'compiled':>13}"
    for name, row in sorted(groups.items(), key=lambda group: -group[1]["seconds"])[:listed]:
        steps = " ".join(f"{row[step]:>6.0f} {row[step + '_s']:>5.1f}s" for step in EVENTS.values())
        yield f"{name[-76:]:<76} {row['seconds']:>8.1f} {row['children']:>8.1f} {steps}"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the sums."""
    if not (path := config.getoption("--processor-time")):
        return
    by: dict[str, defaultdict[str, Counter[str]]] = {
        name: defaultdict(Counter) for name in ("all", "worker", "folder", "file", "function", "test")
    }
    for line in Path(path).read_text().splitlines():
        row = json.loads(line)
        test, worker = row.pop("test"), row.pop("worker")
        file = test.partition("::")[0]
        keys = ("all", worker or "one", str(Path(file).parent), file, test.partition("[")[0], test)
        for groups, key in zip(by.values(), keys, strict=True):
            groups[key].update(row)
    for title, groups in by.items():
        terminalreporter.section(f"processor time by {title}")
        for line in _table(title, groups, 100 if title in ("folder", "file") else LISTED):
            terminalreporter.write_line(line)
