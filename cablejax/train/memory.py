"""Memory that the process has freed and the C library has kept."""

import ctypes
import sys


def release_freed_memory() -> None:
    """Give freed memory back to the system, where the C library can: glibc's `malloc_trim`.

    A compilation leaves about a gigabyte behind that malloc keeps for later. Training does not need it; the jobs beside it
    may.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
