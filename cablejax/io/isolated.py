"""Run a native reader in a process of its own, with limits on time and memory."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from cablejax.io import child
from cablejax.io.raw import BadFile, RawCloud, as_color


def read_isolated(kind: str, path: Path, *, time_limit_s: float) -> RawCloud:
    """Read a LAS, LAZ, COPC ("las") or E57 ("e57") file.

    The process is a fresh interpreter, not a fork: forking deadlocks once JAX runs its threads.

    Raises:
        BadFile: If the file is damaged, the reader crashed or ran out of time, or its package is missing.
    """
    with tempfile.TemporaryDirectory(prefix="cablejax-") as folder:
        # -P keeps this folder, whose modules have common names, off the child's path.
        command = [sys.executable, "-P", child.__file__, kind, str(path.resolve()), folder, str(_memory_limit())]
        try:
            run = subprocess.run(
                command, timeout=time_limit_s, stdin=subprocess.DEVNULL, capture_output=True, check=False
            )
        except subprocess.TimeoutExpired:
            raise BadFile(f"could not be read within {time_limit_s:g} s; it may be damaged") from None
        result = Path(folder, "result.json")
        if not result.is_file():
            raise BadFile(f"is damaged: its reader {_death(run.returncode)}")
        report = json.loads(result.read_text())
        if report["error"] is not None:
            raise BadFile(report["error"])
        return _load(Path(folder), report["dropped"])


def _load(folder: Path, dropped: int) -> RawCloud:
    arrays = {
        name: np.load(folder / f"{name}.npy", allow_pickle=False) if (folder / f"{name}.npy").is_file() else None
        for name in ("xyz", "color", "intensity")
    }
    xyz, color = arrays["xyz"], arrays["color"]
    if xyz is None:
        return RawCloud(np.zeros((0, 3)), dropped=dropped)
    return RawCloud(xyz, None if color is None else as_color(color), arrays["intensity"], dropped)


def _death(code: int) -> str:
    """How a process ended that left no result."""
    if code >= 0:
        return f"stopped with code {code}"
    try:
        return f"crashed ({signal.Signals(-code).name})"
    except ValueError:
        return f"crashed (signal {-code})"


def _memory_limit() -> int:
    """All of the machine's memory as address space; 2 GiB where the system does not tell."""
    try:
        return max(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), 2**31)
    except (AttributeError, ValueError, OSError):
        return 2**31
