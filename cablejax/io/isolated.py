"""Run a native reader in a process of its own, with limits on time and memory."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from cablejax.io import child
from cablejax.io.raw import BadFile, RawCloud

# Thread pools reserve address space, which is limited, and start slowly; reading is sequential.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
LEAST_MEMORY_BYTES = 4 * 2**30


def read_isolated(
    kind: str, path: Path, *, time_limit_s: float, size: int | None = None, box: Sequence[float] = ()
) -> Iterator[RawCloud]:
    """Read a LAS, LAZ, COPC ("las") or E57 ("e57") file piece by piece, or the points of a COPC file in a box ("copc").

    The process is a fresh interpreter, not a fork: forking deadlocks once JAX runs its threads. It ends with the
    iterator, whether that is exhausted or dropped.

    Args:
        kind: "las", "copc" or "e57".
        path: The file.
        time_limit_s: Most time to wait for it, all pieces together.
        size: Points a piece; the reader's choice where it is None.
        box: Of "copc": two corners, six numbers in the file's unit.

    Raises:
        BadFile: If the file is damaged, the reader crashed or ran out of time, or its package is missing.
    """
    # -P keeps this folder, whose modules have common names, off the child's path; file names are UTF-8 in any locale.
    command = [
        sys.executable,
        "-P",
        "-X",
        "utf8",
        child.__file__,
        kind,
        str(path.resolve()),
        str(_memory_limit()),
        str(size or 0),
        *map(repr, map(float, box)),
    ]
    process = subprocess.Popen(
        command,
        env=os.environ | ONE_THREAD,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        bufsize=2**20,
    )
    waited = 0.0
    try:
        while True:
            start = time.monotonic()
            frame, in_time = _receive(process, time_limit_s - waited)
            waited += time.monotonic() - start
            if not in_time:
                raise BadFile(f"could not be read within {time_limit_s:g} s; it may be damaged")
            if frame is None:
                raise BadFile(f"is damaged: its reader {_death(process.wait())}")
            if "error" in frame:
                if frame["error"] is not None:
                    raise BadFile(frame["error"])
                return
            unit = "m" if kind == "e57" else None
            given = {name: frame.get(name) for name in ("color", "intensity", "row")}
            yield RawCloud(frame["xyz"], dropped=frame["dropped"], notes=tuple(frame["notes"]), unit=unit, **given)
    finally:
        process.kill()
        if process.stdout is not None:
            process.stdout.close()
        process.wait()


def _receive(process: subprocess.Popen[bytes], time_limit_s: float) -> tuple[dict[str, Any] | None, bool]:
    """The next frame, None where the process ended without one, and whether it came in time."""
    expired = threading.Event()

    def stop() -> None:
        expired.set()
        process.kill()

    timer = threading.Timer(max(time_limit_s, 0.0), stop)
    timer.daemon = True
    timer.start()
    try:
        assert process.stdout is not None
        return _frame(process.stdout), not expired.is_set()
    finally:
        timer.cancel()


def _frame(stream: IO[bytes]) -> dict[str, Any] | None:
    """Parse a line of JSON and the arrays that it announces."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    frame = json.loads(line)
    for name, (dtype, shape) in frame.pop("arrays", {}).items():
        length = np.dtype(dtype).itemsize * int(np.prod(shape))
        data = stream.read(length)
        if len(data) < length:
            return None
        frame[name] = np.frombuffer(data, dtype).reshape(shape)
    return frame


def _death(code: int) -> str:
    """How a process ended that left no result."""
    if code >= 0:
        return f"stopped with code {code}"
    try:
        return f"crashed ({signal.Signals(-code).name})"
    except ValueError:
        return f"crashed (signal {-code})"


def _memory_limit() -> int:
    """All of the machine's memory as address space, for libraries reserve more of it than they use."""
    try:
        return max(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), LEAST_MEMORY_BYTES)
    except (AttributeError, ValueError, OSError):
        return LEAST_MEMORY_BYTES
