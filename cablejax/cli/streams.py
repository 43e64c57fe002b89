"""Standard output and error as a shell leaves them: closed, full, gone, or in an encoding that lacks letters."""

import contextlib
import io
import os
import sys
import warnings
from collections.abc import Iterator

WARNING = "cablejax: warning: "


def settle_streams() -> None:
    """Let both streams take any text: what they cannot encode is escaped, and one that is closed leads nowhere."""
    while (nowhere := os.open(os.devnull, os.O_RDWR)) <= 2:  # else the next file opened becomes standard output
        os.set_inheritable(nowhere, True)
    os.close(nowhere)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (open as long as the process)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def tell(text: str) -> None:
    """Write a line to standard error; where that is gone or full nobody can be told."""
    try:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()
    except OSError:
        _give_up(sys.stderr)


def warn_plainly(message, category, filename, lineno, file=None, line=None) -> None:
    """A warning in one line, in place of `warnings.showwarning`."""
    tell(f"{WARNING}{message}")


@contextlib.contextmanager
def warnings_told() -> Iterator[list[str]]:
    """Keep what is told on standard error to itself; the list holds the warnings among it at the end, in plain words."""
    told, found = io.StringIO(), []
    with contextlib.redirect_stderr(told), warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = warn_plainly
        try:
            yield found
        finally:
            lines = told.getvalue().splitlines()
            found += dict.fromkeys(line.removeprefix(WARNING) for line in lines if line.startswith(WARNING))


def put_out(text: str = "") -> bool:
    """Write a result to standard output, behind what was written before; False where it cannot be, said on standard error.

    A reader that has gone away (`| head`) has got what it wanted: that is no failure.
    """
    if sys.stdout is None:
        tell("cablejax: the result cannot be written: standard output is closed")
        return False
    try:
        sys.stdout.write(text and f"{text}\n")
        sys.stdout.flush()
    except BrokenPipeError:
        _give_up(sys.stdout)
    except OSError as error:
        _give_up(sys.stdout)
        tell(f"cablejax: the result cannot be written: standard output: {error.strerror}")
        return False
    return True


def _give_up(stream) -> None:
    """Lead a stream nowhere, so that Python does not try once more when it ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
