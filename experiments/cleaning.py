"""The configured filter as one jit-compiled function of a cloud."""

import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from cablejax.ops import OutlierResult, adaptive_filter, median_outliers, radius_outliers, statistical_outliers
from cablejax.types import PointCloud
from experiments.schema import (
    AdaptiveFilterConfig,
    FilterConfig,
    MedianFilterConfig,
    RadiusFilterConfig,
    StatisticalFilterConfig,
)

Cleaner = Callable[[PointCloud], PointCloud]


class Timing(NamedTuple):
    """Seconds of the first call less a warm one, and of a warm call (median)."""

    compile_s: float
    run_s: float


def _only_removal(remove: Callable[[PointCloud], OutlierResult]) -> Cleaner:
    return lambda cloud: PointCloud(cloud.xyz, remove(cloud).keep)


def _adaptive(config: AdaptiveFilterConfig) -> Cleaner:
    def clean(cloud: PointCloud) -> PointCloud:
        kept = statistical_outliers(cloud, k=config.k, std_ratio=config.std_ratio).keep
        inliers = PointCloud(cloud.xyz, kept)
        smooth = adaptive_filter(
            inliers,
            k=config.smooth_k,
            alpha=config.alpha,
            beta=config.beta_mm,
            gamma=config.gamma,
            tau=config.tau,
            order=config.order,
            form=config.form,
            iterations=config.iterations,
        )
        return PointCloud(smooth.xyz, kept)

    return clean


def make_cleaner(config: FilterConfig) -> Cleaner:
    """Build the filter that a configuration asks for.

    Returns:
        A jit-compiled function of a cloud: outliers come back masked and, where the filter smooths, points moved.

    Raises:
        TypeError: If the configuration is of no known filter.
    """
    match config:
        case AdaptiveFilterConfig():
            clean = _adaptive(config)
        case StatisticalFilterConfig():
            clean = _only_removal(lambda cloud: statistical_outliers(cloud, k=config.k, std_ratio=config.std_ratio))
        case RadiusFilterConfig():
            clean = _only_removal(
                lambda cloud: radius_outliers(cloud, radius=config.radius_mm, min_neighbors=config.min_neighbors)
            )
        case MedianFilterConfig():
            clean = _only_removal(lambda cloud: median_outliers(cloud, k=config.k, ratio=config.ratio))
        case _:
            raise TypeError(f"filter: expected a known filter's configuration, got {type(config).__name__}")
    return jax.jit(clean)


def timed(clean: Cleaner, cloud: PointCloud, *, repeats: int) -> tuple[PointCloud, Timing]:
    """Run a filter once to compile it and then `repeats` times on the clock."""
    seconds = []
    result = cloud
    for _ in range(repeats + 1):
        start = time.perf_counter()
        result = jax.block_until_ready(clean(cloud))
        seconds.append(time.perf_counter() - start)
    warm = float(np.median(seconds[1:]))
    return result, Timing(max(0.0, seconds[0] - warm), warm)
