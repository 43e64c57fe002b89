"""Side-by-side timing: contenders take turns, medians and ratios are printed and written with their provenance."""

import ctypes
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks import record

SETTLE_S = 2.0


def open3d_module() -> ModuleType:
    """Open3D, with the libusb that its wheel needs and a bare machine lacks."""
    import libusb_package

    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d


def cable_scan(n: int, *, preset: str = "line-laser", seed: int = 0) -> np.ndarray:
    """Points `[n, 3]` float32 of a simulated scan of one cable, 2 % of them in the air."""
    import jax

    from cablejax.simulate import catalogue, simulate_scan

    scan = simulate_scan(catalogue()[8], n_points=n, preset=preset, key=jax.random.key(seed))
    return np.asarray(scan.xyz_mm, dtype=np.float32)


def half_cylinder(
    n: int, *, noise_mm: float = 0.385, stray_share: float = 0.0, radius_mm: float = 15.0, seed: int = 0
) -> np.ndarray:
    """Points `[n, 3]` float32 of a cable's upper half in random order, at 53,135 points on 300 mm, some of them astray."""
    rng = np.random.default_rng(seed)
    length = 300.0 * n / 53_135
    angle, radius = rng.uniform(0, np.pi, n), radius_mm + noise_mm * rng.normal(size=n)
    xyz = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, length, n)], axis=1)
    stray = rng.random(n) < stray_share
    xyz[stray] = rng.uniform([-30, -30, 0], [30, 30, length], (int(stray.sum()), 3))
    return xyz.astype(np.float32)


def alternate(
    title: str,
    runs: Mapping[str, Callable[[], Any]],
    first_s: Mapping[str, float],
    config: Mapping[str, Any],
    path: Path | None,
) -> dict[str, Any]:
    """Run all contenders in turn, `config["rounds"]` times, and report medians beside the first call's compile time.

    Each is first run for two seconds, as the memory of a process takes tens of calls to settle, and twice in a round, of
    which the second counts.

    Args:
        title: What is measured.
        runs: Contenders; the first is ours, ratios are ours over theirs.
        first_s: Seconds of each contender's first call.
        config: Options of the run; `rounds` is read.
        path: Where to write the result, None for nowhere.

    Returns:
        The table as written, a row each contender, ours first.
    """
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        end = time.perf_counter() + SETTLE_S
        while time.perf_counter() < end:
            run()
    for _ in range(config["rounds"]):
        for name, run in runs.items():
            run()  # not timed: another contender's threads may still spin, and its data fill the caches
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)
    median = {name: float(np.median(times)) for name, times in seconds.items()}
    ours = next(iter(runs))
    rows = [
        {
            "contender": name,
            "median_s": median[name],
            "quartiles_s": [float(q) for q in np.percentile(times, [25, 75])],
            "first_call_extra_s": max(0.0, first_s[name] - median[name]),
            "ours_over_this": median[ours] / median[name],
        }
        for name, times in seconds.items()
    ]
    print(f"{title}: {config}")
    print(f"{'':24s}{'median':>10s}{'first call':>12s}{'ours / this':>13s}")
    for row in rows:
        extra, ratio = row["first_call_extra_s"], row["ours_over_this"]
        print(f"{row['contender']:24s}{1e3 * row['median_s']:8.1f} ms{extra:10.2f} s{ratio:12.2f}x")
    found = record.table(rows, title=title, config=config)
    if path is not None:
        record.write(path, {"contenders": found}, seeds=[0], config=config)
    return found
