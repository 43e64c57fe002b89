"""Engines: every task has its outcome, whatever other tasks do to their processes."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from cablejax.batch import Here, Processes, Task, engine_for
from cablejax.batch.child import Child, ClosedError
from tests.batch import folders
from tests.batch.folders import alive

POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and /proc")


def task(function: str, name: str | None = None, folder: str = ".", **arguments) -> Task:
    return Task(name or function, f"tests.batch.faults:{function}", arguments, str(Path(folder).resolve()))


@POSIX
def test_a_task_that_dies_costs_no_other(tmp_path):
    tasks = [task("add", f"add {i}", x=i, y=1) for i in range(6)]
    tasks[2:2] = [
        task("die", "segfault", number=signal.SIGSEGV),
        task("stop", code=3),
        task("fail", text="odd"),
        task("die_once", mark=str(tmp_path / "mark")),
        task("chatter"),
        task("where", folder=str(tmp_path)),
        task("threads"),
    ]
    found = {outcome.name: outcome for outcome in Processes(2).run(tasks)}
    assert len(found) == len(tasks)
    assert [found[f"add {i}"].value for i in range(6)] == [1, 2, 3, 4, 5, 6]
    assert (found["segfault"].kind, found["segfault"].attempts) == ("crashed", 3)
    assert found["segfault"].reason == "its process crashed (SIGSEGV), 3 times"
    assert (found["stop"].kind, "stopped with code 3" in found["stop"].reason) == ("crashed", True)
    assert (found["fail"].kind, found["fail"].reason) == ("raised", "KeyError: 'odd'")
    assert (found["die_once"].value, found["die_once"].attempts) == ("returned", 2)
    assert found["chatter"].value == 5
    assert Path(found["where"].value) == tmp_path.resolve()
    assert found["threads"].value == "1"


@POSIX
def test_a_task_that_takes_too_long_is_given_up_and_costs_no_other(tmp_path):
    slow = task("sleep", seconds=600.0, started=str(tmp_path / "started"))._replace(time_limit_s=20.0)
    found = {outcome.name: outcome for outcome in Processes(1).run([slow, task("add", x=1, y=1)])}
    assert (found["sleep"].kind, found["sleep"].reason, found["sleep"].attempts) == (
        "crashed",
        "took longer than 20 s",
        1,
    )
    assert found["add"].value == 2
    gone_within(int((tmp_path / "started").read_text()), seconds=10)


@POSIX
@pytest.mark.parametrize("beforehand", [{"function": "add", "x": 5, "y": 5}, {"function": "stop", "code": 3}])
def test_what_is_begun_beforehand_is_not_told_and_costs_no_task(beforehand):
    engine = Processes(2)
    engine.warm(task(**beforehand))
    for _ in range(2):
        found = {
            outcome.name: outcome.value for outcome in engine.run([task("add", f"{i}", x=i, y=1) for i in range(5)])
        }
        assert found == {f"{i}": i + 1 for i in range(5)}
    engine.close()


@POSIX
def test_what_is_begun_beforehand_begins_at_once(tmp_path):
    started, engine = tmp_path / "started", Processes(1)
    engine.warm(task("sleep", seconds=0.0, started=str(started)))
    until = time.monotonic() + 60
    while not started.exists() and time.monotonic() < until:
        time.sleep(0.01)
    assert started.exists()
    engine.close()


@POSIX
def test_leaving_early_ends_the_tasks_in_flight(tmp_path):
    started = tmp_path / "started"
    outcomes = Processes(2).run([task("sleep", seconds=600.0, started=str(started)), task("add", x=1, y=1)])
    assert next(outcomes).value == 2
    while not started.exists() or not started.read_text():
        time.sleep(0.01)
    outcomes.close()
    gone_within(int(started.read_text()), seconds=10)


@POSIX
def test_processes_do_not_outlive_one_that_is_killed(tmp_path):
    started = tmp_path / "started"
    code = (
        "from cablejax.batch import Processes, Task\n"
        f"one = Task('a', 'tests.batch.faults:sleep', {{'seconds': 600.0, 'started': {str(started)!r}}}, '.')\n"
        "list(Processes(1).run([one]))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).resolve().parents[2])
    while not started.exists() or not started.read_text():
        time.sleep(0.01)
    process.kill()
    process.wait()
    gone_within(int(started.read_text()), seconds=10)


def gone_within(pid: int, seconds: float) -> None:
    end = time.monotonic() + seconds
    while alive(pid):
        assert time.monotonic() < end, "a process was left over"
        time.sleep(0.01)


@POSIX
def test_processes_stay_for_the_next_run_and_end_with_the_engine(tmp_path):
    engine = Processes(2)
    first = [outcome.value for outcome in engine.run([task("number", str(i)) for i in range(4)])]
    second = [outcome.value for outcome in engine.run([task("number", str(i)) for i in range(4)])]
    assert len(set(first) | set(second)) <= 2
    folders.kill(second[-1])
    assert {outcome.value for outcome in engine.run([task("add", str(i), x=i, y=1) for i in range(9)])} == set(
        range(1, 10)
    )
    engine.close()
    for pid in {*first, *second}:
        gone_within(pid, seconds=10)


def test_a_child_closed_by_another_thread_says_so(tmp_path):
    child = Child()
    threading.Timer(0.5, child.close).start()
    with pytest.raises(ClosedError):
        child.run(task("sleep", seconds=600.0, started=str(tmp_path / "started")))
    child.bury()


def test_in_this_process_an_exception_costs_no_other():
    outcomes = Here().run([task("fail", text="odd"), task("add", x=1, y=1)])
    assert [(outcome.kind, outcome.value) for outcome in outcomes] == [("raised", None), ("returned", 2)]


def test_engines_by_what_was_given():
    assert isinstance(engine_for(jobs=0), Here)
    assert engine_for(jobs=3).jobs == 3  # pyright: ignore[reportAttributeAccessIssue]
    assert engine_for().jobs >= 1  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ValueError, match="jobs: expected at least 1, got -1"):
        engine_for(jobs=-1)
    with pytest.raises(ValueError, match="scheduler: expected no number of jobs beside it, got 2"):
        engine_for(jobs=2, scheduler="tcp://127.0.0.1:1")
