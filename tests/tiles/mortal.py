"""A process of tasks that dies in the middle of one, once."""

import os
import signal
from pathlib import Path

from cablejax.batch import worker


def prepare(mark: str) -> None:
    """Let the first process to begin its second task die in it."""
    begun = 0
    call = worker.call

    def mortal(task):
        nonlocal begun
        begun += 1
        if begun == 2 and not Path(mark).exists():
            Path(mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return call(task)

    worker.call = mortal
