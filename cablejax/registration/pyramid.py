"""Registration from coarse to fine: thinned clouds and a wide reach first, all points and a short reach last."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Num

from cablejax.registration.icp import icp
from cablejax.registration.result import RegistrationResult
from cablejax.registration.step import Kernel, Method
from cablejax.registration.voxels import voxel_pyramid


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
    moving, fixed = (voxel_pyramid(np.asarray(xyz, dtype=np.float64), voxels) for xyz in (source, target))
    for size, thin_source, thin_target in zip(voxels, moving, fixed, strict=True):
        result = icp(
            thin_source,
            thin_target,
            T_init=T,
            method=method,
            kernel=kernel,
            max_iterations=max_iterations,
            max_distance=reach * size,
        )
        T = result.T_target_source
    assert result is not None
    return result
