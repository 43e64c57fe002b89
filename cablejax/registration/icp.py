"""Iterative closest points: correspondences from a k-d tree on the host, the step under jit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Num
from scipy.spatial import KDTree

from cablejax.geometry.normals import plain_tree, surface_normals
from cablejax.registration.correspondences import Correspondences, Oriented, spacing_of
from cablejax.registration.gauss_newton import KERNELS, METHODS, Kernel, Method, Step
from cablejax.registration.result import RegistrationResult
from cablejax.registration.steps import Limits, State, doubtful, steps
from cablejax.types import PointCloud, Status

LEAST_SHARE = 0.01  # normals that are off by 0.1 rad show a sliding cylinder a share of 0.01


def host_points(cloud: PointCloud | Num[np.ndarray, "n 3"], name: str) -> Float[np.ndarray, "n 3"]:
    """The valid points in float64.

    Raises:
        ValueError: If the array is not `[n, 3]`.
    """
    if isinstance(cloud, PointCloud):
        return np.asarray(cloud.xyz, dtype=np.float64)[np.asarray(cloud.mask)]
    xyz = np.asarray(cloud, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ValueError(f"{name}: expected shape [n, 3], got {list(xyz.shape)}")
    finite = np.isfinite(xyz)
    return xyz if finite.all() else xyz[finite.all(axis=1)]


def check_options(method: str, kernel: str, max_iterations: int) -> None:
    """Refuse names that there are not.

    Raises:
        ValueError: Naming the option, what was expected and what came.
    """
    for value, name, allowed in ((method, "method", METHODS), (kernel, "kernel", KERNELS)):
        if value not in allowed:
            raise ValueError(f"{name}: expected one of {', '.join(allowed)}, got {value!r}")
    if max_iterations < 1:
        raise ValueError(f"max_iterations: expected at least 1, got {max_iterations}")


def check_points(moving: np.ndarray, fixed: np.ndarray) -> None:
    """Refuse clouds of too few points to tell a motion.

    Raises:
        ValueError: Naming the cloud.
    """
    for xyz, name in ((moving, "source"), (fixed, "target")):
        if len(xyz) < 6:
            raise ValueError(f"{name}: expected at least 6 points, got {len(xyz)}")


def _shifted(T: np.ndarray, center: np.ndarray, sign: int) -> np.ndarray:
    """A motion written about another origin: `sign` 1 from the world's to `center`, -1 back."""
    out = T.copy()
    out[:3, 3] += sign * (T[:3, :3] @ center - center)
    return out


def _scaled(T: np.ndarray, factor: float) -> np.ndarray:
    """A motion in another unit of length."""
    out = T.copy()
    out[:3, 3] *= factor
    return out


def nothing(T: np.ndarray, count: int, iterations: int) -> RegistrationResult:
    """The result of too few pairs: where it began, and nothing known."""
    unknown = np.zeros((6, 6))
    status = int(Status.EMPTY | Status.NOT_CONVERGED)
    return RegistrationResult(
        T_target_source=T,
        converged=False,
        iterations=iterations,
        inliers=count,
        rmse=float("nan"),
        status=status,
        covariance=unknown,
        observability=np.zeros(6),
        directions=unknown,
        seen=np.zeros(6, bool),
        center=np.zeros(3),
        overlap=0.0,
    )


def icp(
    source: PointCloud | Num[np.ndarray, "n 3"],
    target: PointCloud | Num[np.ndarray, "m 3"],
    *,
    T_init: Float[np.ndarray, "4 4"] | None = None,
    method: Method = "plane",
    max_iterations: int = 60,
    max_distance: float | int | None = None,
    kernel: Kernel = "none",
    tolerance: float | int = 1e-5,
    k_normals: int = 20,
    least_share: float | int = LEAST_SHARE,
) -> RegistrationResult:
    """Find the rigid motion, eq. (9), that takes a source scan onto a target scan, from a start that is near.

    Directions along which the surface slides on itself are found in the normals, reported and not moved along: of the
    motions that fit equally well, a straight cable gets the one that moves its points least.

    Args:
        source: Points `[n, 3]`, or a padded cloud.
        target: Points `[m, 3]`, in the same unit.
        T_init: Where to begin; the identity if None.
        method: "point" (distance to the corresponding point), "plane" (distance to its tangent plane), or "gicp" (Segal et al.
            2009: both clouds as small flat patches).
        max_iterations: Most steps.
        max_distance: Corresponding points are no further apart; ten times the target's median spacing if None.
        kernel: Robust kernel on the residuals: "none", "huber", "cauchy" or "tukey".
        tolerance: Convergence: the step's displacement, in median spacings of the target; ten times that where the pairs no
            longer come nearer.
        k_normals: Neighbours from which normals come.
        least_share: See `icp_step`: what counts as unseen.

    Returns:
        The motion and what is known about it. With fewer than six pairs the status holds `EMPTY`.

    Raises:
        ValueError: If a cloud is not `[n, 3]` or holds fewer than six points, or an option is none of those listed.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> box = rng.uniform(size=(3000, 3)); box[np.arange(3000), np.arange(3000) % 3] = 0
        >>> result = icp(box + [0.01, 0.0, -0.01], box, max_distance=0.1)
        >>> np.abs(result.T_target_source[:3, 3] - [-0.01, 0.0, 0.01]).max() < 1e-4
        np.True_
    """
    moving, fixed = host_points(source, "source"), host_points(target, "target")
    check_options(method, kernel, max_iterations)
    start = np.eye(4) if T_init is None else np.asarray(T_init, dtype=np.float64)
    check_points(moving, fixed)
    tree = plain_tree(fixed)
    spacing = spacing_of(tree, fixed)
    normals = surface_normals(moving, k=k_normals) if method == "gicp" else np.zeros_like(moving)
    options = Options(method, kernel, max_iterations, float(tolerance), float(least_share))
    return between(
        Oriented(moving, normals),
        Oriented(fixed, surface_normals(fixed, k=k_normals, tree=tree)),
        tree,
        start,
        options,
        spacing=spacing,
        max_distance=10 * spacing if max_distance is None else float(max_distance),
    )


class Options(NamedTuple):
    """What `icp` is told, all but the clouds, the start and the maximum distance."""

    method: Method
    kernel: Kernel
    max_iterations: int
    tolerance: float
    least_share: float


def between(
    moving: Oriented,
    fixed: Oriented,
    tree: KDTree,
    start: Float[np.ndarray, "4 4"],
    options: Options,
    *,
    spacing: float,
    max_distance: float,
    capacity: int = 0,
) -> RegistrationResult:
    """`icp` of clouds that have their normals, and the target its tree.

    Args:
        moving, fixed: Source and target, in the same unit.
        tree: Over the target's points.
        start: Where to begin.
        options: See `icp`.
        spacing: Of the target's points, about, for the tolerance.
        max_distance: Maximum distance between corresponding points.
        capacity: Source points of the largest of several levels: smaller ones are compiled for a half, a quarter, ... of it.
    """
    # Under jit all is float32 and of order one: a twist mixes lengths with angles, so the unit must not matter.
    origin = fixed.xyz.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((fixed.xyz - origin) ** 2, axis=1))))
    if min(len(moving.xyz), len(fixed.xyz)) < 6 or size == 0:
        return nothing(start, 0, 0)
    small, large = (Oriented((cloud.xyz - origin) / size, cloud.normals) for cloud in (moving, fixed))
    correspondences = Correspondences(
        small, large, tree, max_distance=max_distance / size, scale=(origin, size), capacity=capacity
    )
    least_move = options.tolerance * spacing / size + 1e-7 * float(np.abs(large.xyz).max())
    T, state, done = _aligned(
        correspondences, _scaled(_shifted(start, origin, 1), 1 / size), max_distance / size, least_move, options
    )
    inliers = int(state.step.inliers)
    if inliers < 6:
        return nothing(_shifted(_scaled(T, size), origin, -1), inliers, done)
    return _result(state.step, T, origin, size, converged=bool(state.small), iterations=done, count=len(moving.xyz))


def _aligned(
    correspondences: Correspondences, T: np.ndarray, max_distance: float, least_move: float, options: Options
) -> tuple[np.ndarray, State, int]:
    """Step under jit, ask the tree again where correspondences are in doubt, and so on until the motion is small."""
    numbers = [np.float32(value) for value in (max_distance, least_move, options.least_share)]
    carried, done = correspondences.ask(T, None), 0
    while True:
        limits = Limits(*numbers, np.int32(options.max_iterations - done))  # pyright: ignore
        state: State = steps(carried, T.astype(np.float32), limits, method=options.method, kernel=options.kernel)
        T, done = _orthonormal(np.asarray(state.T_target_source, dtype=np.float64)), done + int(state.done)
        if not bool(state.doubtful) or done >= options.max_iterations:
            return T, state, done
        which = np.asarray(doubtful(carried, T.astype(np.float32), numbers[0]))
        carried = correspondences.ask(T, which)


def _result(
    step: Step, T: np.ndarray, origin: np.ndarray, size: float, *, converged: bool, iterations: int, count: int
) -> RegistrationResult:
    """The last step in the caller's unit and frame."""
    seen = np.asarray(step.seen)
    to_unit = np.repeat([size, 1.0], 3)  # translations carry the unit, rotations do not
    covariance = to_unit[:, None] * np.asarray(step.covariance, dtype=np.float64) * to_unit[None, :]
    status = (Status.OK if converged else Status.NOT_CONVERGED) | (Status.OK if seen.all() else Status.DEGENERATE)
    return RegistrationResult(
        T_target_source=_shifted(_scaled(T, size), origin, -1),
        converged=converged,
        iterations=iterations,
        inliers=int(step.inliers),
        rmse=float(step.rmse) * size,
        status=int(status),
        covariance=covariance,
        observability=np.asarray(step.observability, dtype=np.float64),
        directions=to_unit[:, None] * np.asarray(step.directions, dtype=np.float64) / size,
        seen=seen,
        center=np.asarray(step.center, dtype=np.float64) * size + origin,
        overlap=int(step.inliers) / count,
    )


def _orthonormal(T: np.ndarray) -> np.ndarray:
    """The nearest rotation in float64: float32 products drift by a rounding a step."""
    u, _, vt = np.linalg.svd(T[:3, :3])
    out = T.copy()
    out[:3, :3] = u @ vt
    return out
