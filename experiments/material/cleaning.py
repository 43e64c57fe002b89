"""The configured filter as one jit-compiled function of a cloud."""

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np

from cablejax.ops import OutlierResult, clean, median_outliers, radius_outliers, statistical_outliers
from cablejax.types import PointCloud
from experiments.harness.schema import (
    AdaptiveFilterConfig,
    FilterConfig,
    MedianFilterConfig,
    RadiusFilterConfig,
    StatisticalFilterConfig,
)

Cleaner = Callable[[PointCloud], PointCloud]


class Timing(NamedTuple):
    """Seconds of the first call less a warm one (near 0 where the process has compiled it before), and of a warm call."""

    compile_s: float
    run_s: float


def _only_removal(remove: Callable[[PointCloud], OutlierResult]) -> Cleaner:
    return lambda cloud: PointCloud(cloud.xyz, remove(cloud).keep)


def _adaptive(config: AdaptiveFilterConfig) -> Cleaner:
    default_k, default_gamma = (40, 0.1) if config.order == 0 else (100, 0.0)
    gamma = default_gamma if config.gamma is None else config.gamma

    def run(cloud: PointCloud) -> PointCloud:
        # A weight that is off is left out, not multiplied by one.
        edges = {} if gamma == 0 else {"gamma": gamma, "tau": config.tau}
        result = clean(
            cloud,
            removal_k=config.k,
            std_ratio=config.std_ratio,
            k=config.smooth_k or default_k,
            alpha=config.alpha,
            beta=config.beta_mm,
            order=config.order,
            form=config.form,
            iterations=config.iterations,
            **edges,
        )
        return PointCloud(result.xyz, result.keep)

    return run


def make_cleaner(config: FilterConfig) -> Cleaner:
    """Build the filter that a configuration asks for; equal configurations share one, so that it is compiled once.

    Returns:
        A jit-compiled function of a cloud: outliers come back masked and, where the filter smooths, points moved.

    Raises:
        TypeError: If the configuration is of no known filter.
    """
    return _cleaner(type(config), tuple(sorted(asdict(config).items())))


@lru_cache(maxsize=8)
def _cleaner(kind: type[FilterConfig], values: tuple[tuple[str, object], ...]) -> Cleaner:
    config: FilterConfig = kind(**dict(values))  # pyright: ignore[reportArgumentType]
    match config:
        case AdaptiveFilterConfig():
            cleaner = _adaptive(config)
        case StatisticalFilterConfig():
            cleaner = _only_removal(lambda cloud: statistical_outliers(cloud, k=config.k, std_ratio=config.std_ratio))
        case RadiusFilterConfig():
            cleaner = _only_removal(
                lambda cloud: radius_outliers(cloud, radius=config.radius_mm, min_neighbors=config.min_neighbors)
            )
        case MedianFilterConfig():
            cleaner = _only_removal(lambda cloud: median_outliers(cloud, k=config.k, ratio=config.ratio))
        case _:
            raise TypeError(f"filter: expected a known filter's configuration, got {kind.__name__}")
    return jax.jit(cleaner)


def timed(cleaner: Cleaner, cloud: PointCloud, *, repeats: int) -> tuple[PointCloud, Timing]:
    """Run a filter once to compile it and then `repeats` times on the clock."""
    seconds = []
    result = cloud
    for _ in range(repeats + 1):
        start = time.perf_counter()
        result = jax.block_until_ready(cleaner(cloud))
        seconds.append(time.perf_counter() - start)
    warm = float(np.median(seconds[1:]))
    return result, Timing(max(0.0, seconds[0] - warm), warm)
