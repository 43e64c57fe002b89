"""Registration from coarse to fine: thinned clouds and a large maximum distance first, all points and a small one last."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float, Num

from cablejax.geometry.normals import plain_tree
from cablejax.registration.coarse import coarse_start
from cablejax.registration.correspondences import Oriented
from cablejax.registration.gauss_newton import Kernel, Method
from cablejax.registration.icp import LEAST_SHARE, Options, between, check_options, check_points, host_points, nothing
from cablejax.registration.result import RegistrationResult
from cablejax.registration.voxels import voxel_pyramid

TOLERANCE, COARSE_TOLERANCE = 1e-3, 3e-2  # of the spacing: a coarse level only has to bring the next one near


def register(
    source: Num[np.ndarray, "n 3"],
    target: Num[np.ndarray, "m 3"],
    *,
    voxels: Sequence[float | int],
    max_distance_voxels: float | int = 4.0,
    T_init: Float[np.ndarray, "4 4"] | None = None,
    method: Method = "gicp",
    kernel: Kernel = "none",
    max_iterations: int = 60,
    start: str = "given",
    least_share: float | int = LEAST_SHARE,
) -> RegistrationResult:
    """`icp` on ever finer clouds, each level from where the one before ended.

    Args:
        source: Points `[n, 3]`.
        target: Points `[m, 3]`, in the same unit.
        voxels: Side of the voxels at each level, coarse to fine, in that unit.
        max_distance_voxels: Maximum distance between corresponding points, in voxels.
        T_init: Where to begin; the identity if None.
        method, kernel, max_iterations: As in `icp`.
        least_share: As in `icp`: what counts as unseen.
        start: "given" for `T_init`, "features" where nothing is known of the pose: `coarse_start` at the coarsest voxel.

    Returns:
        The result of the finest level.

    Raises:
        ValueError: If a cloud holds fewer than six points, `voxels` is empty or holds a number that is not positive, an option
            is none of those listed, or no coarse start is found.
    """
    if len(voxels) == 0:
        raise ValueError("voxels: expected at least one size, got none")
    check_options(method, kernel, max_iterations)
    if start not in ("given", "features"):
        raise ValueError(f"start: expected one of given, features, got {start!r}")
    T = np.eye(4) if T_init is None else np.asarray(T_init, dtype=np.float64)
    moving, fixed = host_points(source, "source"), host_points(target, "target")
    check_points(moving, fixed)
    if start == "features":
        T = coarse_start(moving, fixed, voxel=max(voxels)).T_target_source
    if method == "gicp":
        with ThreadPoolExecutor(1) as pool:  # NumPy and the tree release the lock: the clouds are thinned side by side
            ahead = pool.submit(voxel_pyramid, fixed, voxels, spread=True)
            near, far = voxel_pyramid(moving, voxels, spread=True), ahead.result()
    else:  # without normals the source is done in less time than threads take to begin
        near, far = voxel_pyramid(moving, voxels, spread=False), voxel_pyramid(fixed, voxels, spread=True)
    capacity = max(len(level.xyz) for level in near)
    result = nothing(T, 0, 0)
    for number, (size, source_level, target_level) in enumerate(zip(voxels, near, far, strict=True), 1):
        small, large = (Oriented(level.xyz, level.normals()) for level in (source_level, target_level))
        tree = target_level.tree or plain_tree(large.xyz)
        tolerance = TOLERANCE if number == len(voxels) else COARSE_TOLERANCE
        options = Options(method, kernel, max_iterations, tolerance, float(least_share))
        result = between(
            small, large, tree, T, options, spacing=size, max_distance=max_distance_voxels * size, capacity=capacity
        )
        T = result.T_target_source
    return result
