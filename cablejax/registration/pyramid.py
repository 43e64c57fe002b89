"""Registration from coarse to fine: thinned clouds and a wide reach first, all points and a short reach last."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Num

from cablejax.registration.icp import icp
from cablejax.registration.result import RegistrationResult
from cablejax.registration.step import Kernel, Method


def voxel_means(xyz: Float[np.ndarray, "n 3"], size: float | int) -> Float[np.ndarray, "m 3"]:
    """The mean of the points in each voxel of side `size`.

    Raises:
        ValueError: If `size` is not positive.

    Example:
        >>> voxel_means(np.array([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [1.5, 0.0, 0.0]]), 1.0).round(3).tolist()
        [[0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    """
    if not size > 0:
        raise ValueError(f"size: expected a positive number, got {size}")
    cells = np.floor(xyz / size).astype(np.int64)
    _, group, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    sums = np.stack([np.bincount(group, weights=xyz[:, axis]) for axis in range(3)], axis=1)
    return sums / count[:, None]


def register(
    source: Num[np.ndarray, "n 3"],
    target: Num[np.ndarray, "m 3"],
    *,
    voxels: Sequence[float | int],
    reach: float | int = 4.0,
    T_init: Float[np.ndarray, "4 4"] | None = None,
    method: Method = "gicp",
    kernel: Kernel = "none",
    max_iterations: int = 60,
) -> RegistrationResult:
    """`icp` on ever finer clouds, each level from where the one before ended.

    Args:
        source: Points `[n, 3]`.
        target: Points `[m, 3]`, in the same unit.
        voxels: Side of the voxels at each level, coarse to fine, in that unit.
        reach: Largest distance between partners, in voxels.
        T_init: Where to begin; the identity if None.
        method, kernel, max_iterations: As in `icp`.

    Returns:
        The result of the finest level.

    Raises:
        ValueError: If `voxels` is empty or holds a number that is not positive.
    """
    if len(voxels) == 0:
        raise ValueError("voxels: expected at least one size, got none")
    T, result = T_init, None
    for size in voxels:
        result = icp(
            voxel_means(np.asarray(source, dtype=np.float64), size),
            voxel_means(np.asarray(target, dtype=np.float64), size),
            T_init=T,
            method=method,
            kernel=kernel,
            max_iterations=max_iterations,
            max_distance=reach * size,
        )
        T = result.T_target_source
    assert result is not None
    return result
