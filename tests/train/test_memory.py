"""Freed memory goes back to the system."""

import ctypes
import sys
from pathlib import Path

import pytest

from cablejax.train.memory import release_freed_memory

BLOCK, BLOCKS = 100_000, 1_000


def resident_bytes() -> int:
    status = Path("/proc/self/status").read_text()
    return 1024 * int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])


@pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="needs glibc")
def test_freed_blocks_leave_the_resident_set():
    libc = ctypes.CDLL(None)
    libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = (
        ctypes.c_void_p,
        [ctypes.c_size_t],
        [ctypes.c_void_p],
    )
    blocks = [libc.malloc(BLOCK) for _ in range(BLOCKS)]
    for block in blocks:
        ctypes.memset(block, 1, BLOCK)
    for block in blocks[:-1]:  # the last one keeps malloc from shrinking the heap by itself
        libc.free(block)
    before = resident_bytes()
    release_freed_memory()
    released = before - resident_bytes()
    libc.free(blocks[-1])
    assert released > 0.8 * BLOCK * BLOCKS
