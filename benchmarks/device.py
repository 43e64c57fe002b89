"""Every kernel on the device at hand, checked against NumPy and timed, in one bounded run: `python -m benchmarks.device`.

Made for an accelerator that is lent for minutes: one process, kernels in the order of their weight, each result printed and
written as it comes, and an end at `--seconds` whatever is running then. On a CPU the same is run at reduced sizes, which
says whether the program is right. `--only` runs the kernels whose name holds a word.
"""

import argparse
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import record
from benchmarks.device_kernels import KERNELS, Kernel

ROUNDS, ENOUGH_S = 20, 1.0  # timed calls of each, unless they take longer than this together


def main() -> None:
    """Run what there is time for, print and write a row for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=480.0, help="the run ends by then, compiling included")
    parser.add_argument(
        "--out", type=Path, help="file of the results; results/benchmarks/device_<platform>.json if not given"
    )
    parser.add_argument("--only", default="", help="a word in the names of the kernels to run")
    parser.add_argument("--full", action="store_true", help="run the accelerator's sizes on a CPU too")
    options = parser.parse_args()
    end = time.monotonic() + options.seconds
    import jax

    device = jax.devices()[0]
    kernels = [kernel for kernel in KERNELS if options.only in kernel.name]
    reduced = device.platform == "cpu" and not options.full
    rows: list[dict[str, Any]] = []
    out = options.out or Path(f"results/benchmarks/device_{device.platform}.json")
    watch = threading.Timer(options.seconds, lambda: os._exit(_ended(rows, options.seconds)))
    watch.daemon = True
    watch.start()
    print(f"{device.device_kind}, {'reduced sizes, ' if reduced else ''}at most {options.seconds:.0f} s")
    print(f"{'':38s}{'points':>10s}{'first':>9s}{'run':>11s}{'beside':>10s}  NumPy")
    jobs = [(kernel, n) for kernel in kernels for n in ((kernel.small,) if reduced else kernel.sizes)]
    for kernel, n in jobs:
        rows.append(run(kernel, n, end))
        show(rows[-1])
        write(out, rows, options.seconds, reduced)
    watch.cancel()
    wrong = [row["kernel"] for row in rows if row["check"] != "agrees"]
    print(f"written to {out}" + (f"; look at {', '.join(wrong)}" if wrong else ""))
    raise SystemExit(1 if wrong else 0)


def run(kernel: Kernel, n: int, end: float) -> dict[str, Any]:
    """First call, check and timing of one kernel at one size; whatever goes wrong is part of the row."""
    row: dict[str, Any] = {"kernel": kernel.name, "points": n, "beside_ms": kernel.beside_ms.get(n), "check": "agrees"}
    if time.monotonic() > end - 1.0:
        return {**row, "check": "not reached"}
    try:
        call, check = kernel.make(n)
        start = time.monotonic()
        result = finished(call)
        row["first_s"] = time.monotonic() - start
        row["run_ms"], row["calls"] = timed(call, end)
        row["peak_mb"] = peak_mb()
        check(result)
    except AssertionError as error:
        row["check"] = "differs: " + " ".join(str(error).split())[:300]
    except Exception as error:  # noqa: BLE001  (the run goes on with the next kernel)
        row["check"] = f"failed: {type(error).__name__}: " + " ".join(str(error).split())[:300]
    return row


def finished(call: Callable[[], Any]) -> Any:
    """What a call returns, once the device has it."""
    import jax

    return jax.block_until_ready(call())


def timed(call: Callable[[], Any], end: float) -> tuple[float, int]:
    """Median time of a call in ms, and of how many."""
    times: list[float] = []
    while not times or (len(times) < ROUNDS and sum(times) < ENOUGH_S and time.monotonic() < end):
        start = time.perf_counter()
        finished(call)
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times)), len(times)


def peak_mb() -> float | None:
    """Most memory that the device has held so far in this process, where it says so."""
    import jax

    stats = jax.devices()[0].memory_stats()
    return stats["peak_bytes_in_use"] / 2**20 if stats and "peak_bytes_in_use" in stats else None


def show(row: dict[str, Any]) -> None:
    """Print one row."""
    first, took = (f"{row[key]:.1f} s" if key in row else "" for key in ("first_s",)), row.get("run_ms")
    beside = row["beside_ms"]
    cells = (*first, "" if took is None else f"{took:.2f} ms", "" if beside is None else f"{beside:g} ms")
    columns = "".join(f"{cell:>{width}s}" for cell, width in zip(cells, (9, 11, 10), strict=True))
    print(f"{row['kernel']:38s}{row['points']:>10,d}{columns}  {row['check']}", flush=True)


def write(out: Path, rows: list[dict[str, Any]], seconds: float, reduced: bool) -> None:
    """Write all rows so far, the old file staying until the new one is whole."""
    config = {"seconds": seconds, "reduced": reduced}
    record.write(out, {"kernels": record.table(rows, config=config)}, config=config)


def _ended(rows: list[dict[str, Any]], seconds: float) -> int:
    """Say how far the run came: the results are on the disk."""
    print(f"ended after {seconds:.0f} s with {len(rows)} rows written; the last kernel did not finish", flush=True)
    return 1


if __name__ == "__main__":
    main()
