"""A process for tasks, seen from outside: started when it is needed, and anew when it has died."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from typing import IO

from cablejax.batch.task import Outcome, Task

# One thread for each: several processes share the cores, and sums in one order have the same last bits everywhere.
ENVIRONMENT = {
    "NPROC": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYTHONUNBUFFERED": "1",
    "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # several processes share an accelerator
}
START = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from cablejax.batch.worker import main; main(); "
    "import os; os._exit(0)"  # threads of native libraries may hold up an orderly end
)
RETRIES = 2


class ClosedError(Exception):
    """The child was closed."""


class Child:
    """Runs tasks one after the other in a process of its own. One thread runs them; any may close it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._errors: IO[bytes] | None = None
        self.closed, self._late = False, False
        self._unheard = 0  # answers to tasks that nobody waits for
        self._lock = threading.Lock()

    def run(self, task: Task, *, retries: int = RETRIES) -> Outcome:
        """A task's outcome; where its process dies, it is begun anew in a fresh one up to `retries` times.

        One that takes too long is not: it would again.

        Raises:
            ClosedError: If the child was closed before or meanwhile.
        """
        reason = ""
        for attempt in range(1, retries + 2):
            outcome = self._attempt(task)
            if outcome is not None:
                return outcome._replace(attempts=attempt)
            reason = self._buried()
            if self._late:
                reason = f"took longer than {task.time_limit_s:g} s"
                return Outcome(task.name, "crashed", reason=reason, attempts=attempt)
        return Outcome(task.name, "crashed", reason=f"its process {reason}, {retries + 1} times", attempts=retries + 1)

    def warm(self, task: Task) -> None:
        """Begin a task whose outcome nobody waits for; the next one is begun after it."""
        self._unheard += self._handed(task) is not None

    def _attempt(self, task: Task) -> Outcome | None:
        """The outcome, None where the process has died."""
        self._late = False
        process = self._handed(task)
        if process is None:
            return None
        assert process.stdout is not None
        with self._limited(task.time_limit_s, process):
            while self._unheard:
                process.stdout.readline()
                self._unheard -= 1
            line = process.stdout.readline()
        if not line.endswith("\n"):
            return None
        *outcome, last = json.loads(line)
        if last:
            self._buried()
        return Outcome(*outcome)

    def _handed(self, task: Task) -> subprocess.Popen[str] | None:
        """The process, with the task in its queue; None where it has died since the last one."""
        process = self._process if self._process is not None else self._started()
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(task) + "\n")
            process.stdin.flush()
        except OSError:
            return None
        return process

    @contextlib.contextmanager
    def _limited(self, seconds: float | None, process: subprocess.Popen[str]) -> Iterator[None]:
        """Kill the process when the time is over."""

        def stop() -> None:
            self._late = True
            process.kill()

        timer = threading.Timer(seconds if seconds is not None else 0.0, stop)
        timer.daemon = True
        if seconds is not None:
            timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _started(self) -> subprocess.Popen[str]:
        with self._lock:
            if self.closed:
                raise ClosedError
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (open as long as the process)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", START, json.dumps(sys.path)],
                env=os.environ | ENVIRONMENT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                encoding="utf-8",
                start_new_session=True,  # Ctrl-C is for who waits for the results
            )
            return self._process

    def _buried(self) -> str:
        """Wait for a process that is dying, forget it, and say how it died."""
        process, errors = self._process, self._errors
        assert process is not None
        assert errors is not None
        code = process.wait()
        errors.seek(0)
        said = errors.read().decode(errors="replace").strip().splitlines()
        for stream in (errors, process.stdin, process.stdout):
            with contextlib.suppress(OSError):  # what it did not take any more
                stream.close()  # pyright: ignore[reportOptionalMemberAccess]
        self._process, self._errors, self._unheard = None, None, 0
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"crashed ({signal.Signals(-code).name})"
        return f"stopped with code {code}" + (f" ({said[-1]})" if said else "")

    def close(self) -> None:
        """End the process, in the middle of a task too: its `run` raises `ClosedError`."""
        with self._lock:
            self.closed = True
            if self._process is not None:
                self._process.kill()

    def bury(self) -> None:
        """Close, and wait for the end; when no thread runs a task in it."""
        self.close()
        if self._process is not None:
            self._buried()
