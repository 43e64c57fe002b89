"""Where tasks run: in this process, in several of this machine, or on the workers of a Dask cluster."""

import contextlib
import logging
import os
import queue
import threading
import uuid
from collections.abc import Generator, Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

from cablejax.batch.child import Child, ClosedError
from cablejax.batch.task import Outcome, Task, call
from cablejax.optional import require

CONNECT_S = 30.0


@runtime_checkable
class Engine(Protocol):
    """Runs tasks in any order, and gives their outcomes as they come."""

    def run(self, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
        """An outcome a task. Closing the generator ends the tasks in flight."""
        ...

    def warm(self, task: Task) -> None:
        """Begin a task, whose outcome nobody waits for, where it does not keep this process from its own work."""
        ...

    def close(self) -> None:
        """Let go of what is kept between runs."""
        ...


class Here:
    """One after the other in this process: a crash is everybody's."""

    def run(self, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
        """As `Engine.run`; KeyboardInterrupt goes through."""
        for task in tasks:
            yield call(task)

    def warm(self, task: Task) -> None:
        """It would keep this process; nothing is begun."""

    def close(self) -> None:
        """Nothing is kept."""


class Processes:
    """In processes of this machine, each with one thread; they stay for the next run, until the engine is closed.

    Args:
        jobs: How many at once; as many as there are cores if None.

    Raises:
        ValueError: If `jobs` is below 1.
    """

    def __init__(self, jobs: int | None = None):
        self.jobs = usable_cores() if jobs is None else jobs
        if self.jobs < 1:
            raise ValueError(f"jobs: expected at least 1, got {jobs}")
        self._idle: list[Child] = []

    def run(self, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
        """As `Engine.run`."""
        todo: queue.SimpleQueue[Task] = queue.SimpleQueue()
        for task in tasks:
            todo.put(task)
        found: queue.SimpleQueue[Outcome | BaseException] = queue.SimpleQueue()
        children = [self._idle.pop() if self._idle else Child() for _ in range(min(self.jobs, len(tasks)))]
        threads = [threading.Thread(target=_feed, args=(child, todo, found), daemon=True) for child in children]
        for thread in threads:
            thread.start()
        left = len(tasks)
        try:
            while left:
                outcome = found.get()
                if isinstance(outcome, BaseException):
                    raise outcome
                left -= 1
                yield outcome
        finally:
            if left:
                for child in children:
                    child.close()
            for child, thread in zip(children, threads, strict=True):
                thread.join()
                if child.closed:
                    child.bury()
                else:
                    self._idle.append(child)

    def warm(self, task: Task) -> None:
        """Begin the task in every process, all of which are started."""
        self._idle += [Child() for _ in range(self.jobs - len(self._idle))]
        for child in self._idle:
            child.warm(task)

    def close(self) -> None:
        """End the processes."""
        while self._idle:
            self._idle.pop().bury()

    def __del__(self) -> None:
        if hasattr(self, "_idle"):  # not where `jobs` was refused
            self.close()


def _feed(child: Child, todo: "queue.SimpleQueue[Task]", found: "queue.SimpleQueue[Outcome | BaseException]") -> None:
    """Hand tasks to a child until there are none."""
    try:
        while True:
            found.put(child.run(todo.get_nowait()))
    except (queue.Empty, ClosedError):
        pass
    except BaseException as error:  # noqa: BLE001 (no more processes, say: who waits must hear of it)
        child.close()
        found.put(error)


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class EngineError(Exception):
    """An engine cannot be reached, or was lost; the message says which."""


class Dask:
    """On the workers of a Dask cluster, which must see the same files and have cablejax installed.

    Each thread of a worker has a process of its own for tasks, as `Processes` has: a task that crashes costs the worker
    nothing, and the numbers are the same bit for bit. A worker that dies costs a retry of its tasks on others.

    Args:
        address: Of the scheduler: "tcp://10.0.0.1:8786".

    Raises:
        MissingPackageError: If dask.distributed is not installed.
    """

    def __init__(self, address: str):
        require("distributed", why="--scheduler")
        self.address = address

    def run(self, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
        """As `Engine.run`.

        Raises:
            EngineError: If no scheduler answers, or it has gone meanwhile.
        """
        from distributed import Client, as_completed

        try:
            client = Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise EngineError(f"--scheduler {self.address}: no Dask scheduler answers there ({error})") from None
        with _unlogged("distributed.client"), client:
            run = uuid.uuid4().hex  # a scheduler remembers the keys of others
            futures: dict[Any, Task] = {
                client.submit(on_worker, task, key=f"{task.name}-{run}", pure=False): task for task in tasks
            }
            for future in as_completed(list(futures), loop=client.loop):
                yield self._outcome(future, futures.pop(future))

    def warm(self, task: Task) -> None:
        """Workers are not known before there is work for them; nothing is begun."""

    def close(self) -> None:
        """Nothing is kept here."""

    def _outcome(self, future: Any, task: Task) -> Outcome:
        if future.status == "finished":
            return Outcome(*future.result())
        if future.status in ("cancelled", "lost"):
            raise EngineError(f"--scheduler {self.address}: the scheduler has gone")
        error = future.exception()
        return Outcome(task.name, "crashed", reason=f"the cluster gave it up ({type(error).__name__}: {error})")


@contextlib.contextmanager
def _unlogged(name: str) -> Iterator[None]:
    """Keep a logger still: what it has to say, with tracebacks, an `EngineError` says in a sentence."""
    logger = logging.getLogger(name)
    logger.disabled, before = True, logger.disabled
    try:
        yield
    finally:
        logger.disabled = before


_mine = threading.local()


def on_worker(task: Task) -> tuple[Any, ...]:
    """Run a task on a Dask worker, in the process of this thread."""
    if not hasattr(_mine, "child"):
        _mine.child = Child()
    return tuple(_mine.child.run(Task(*task)))


def engine_for(*, jobs: int | None = None, scheduler: str | None = None) -> Engine:
    """The engine for what a user gave.

    Args:
        jobs: Processes on this machine; 0 for none but this one; as many as there are cores if None.
        scheduler: Address of a Dask scheduler, in place of `jobs`.

    Raises:
        ValueError: If `jobs` is below 0, or both are given.
        MissingPackageError: If `scheduler` is given and dask.distributed is not installed.
    """
    if scheduler is not None:
        if jobs is not None:
            raise ValueError(f"scheduler: expected no number of jobs beside it, got {jobs}")
        return Dask(scheduler)
    return Here() if jobs == 0 else Processes(jobs)
