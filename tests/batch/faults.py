"""Functions for tasks: they return, raise, or take their process with them."""

import os
import signal
import time
from pathlib import Path


def add(x: int, y: int) -> int:
    return x + y


def fail(text: str) -> None:
    raise KeyError(text)


def die(number: int) -> None:
    os.kill(os.getpid(), number)


def stop(code: int) -> None:
    os._exit(code)


def die_once(mark: str) -> str:
    """Die the first time, return the second."""
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "returned"


def chatter() -> int:
    """Write where answers are expected."""
    print("not an answer")  # noqa: T201
    os.write(1, b"nor this\n")
    return 5


def sleep(seconds: float, started: str) -> None:
    Path(started).write_text(str(os.getpid()))
    time.sleep(seconds)


def where() -> str:
    return os.getcwd()


def threads() -> str:
    return os.environ["NPROC"]


def number() -> int:
    return os.getpid()
