"""A straight cylinder fitted to a few hundred points: the brick of the search and of the track along a cable."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.geometry.robust import robust_std


class Cylinder(NamedTuple):
    """A point of the axis `[3]`, its unit direction `[3]`, and the radius in mm."""

    center: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]
    radius_mm: float


def frame(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two unit vectors square to a unit direction and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def radial(cylinder: Cylinder, xyz: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance from the axis `[n]`, unit outward direction `[n, 3]`, position along the axis `[n]`."""
    offset = xyz - cylinder.center
    along = offset @ cylinder.direction
    outward = offset - along[:, None] * cylinder.direction
    distance = np.linalg.norm(outward, axis=1)
    return distance, outward / np.maximum(distance, 1e-12)[:, None], along


def _step(local: np.ndarray, state: np.ndarray, scale: float, prior: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step on (a, b, slope a, slope b, r) with Huber weights and a pull to the prior."""
    x, y, z = local.T
    dx, dy = x - state[0] - state[2] * z, y - state[1] - state[3] * z
    distance = np.maximum(np.hypot(dx, dy), 1e-12)
    residual = distance - state[4]
    ux, uy = dx / distance, dy / distance
    jacobian = np.stack([-ux, -uy, -z * ux, -z * uy, -np.ones_like(ux)], axis=1)
    robust = 1 / np.maximum(1, np.abs(residual) / (1.5 * scale))
    normal = jacobian.T @ (robust[:, None] * jacobian) + np.diag(weight)
    gradient = jacobian.T @ (robust * residual) + weight * (state - prior)
    return state - np.linalg.solve(normal, gradient)


def fit_cylinder(
    xyz: Float[np.ndarray, "n 3"], start: Cylinder, *, radius_weight: float = 0.0, iterations: int = 6
) -> tuple[Cylinder, float]:
    """Least squares with Huber weights from a start that is near.

    Args:
        xyz: Points `[n, 3]`, mm; six or more.
        start: Where to begin; its direction may be some 30 degrees off.
        radius_weight: How many points the start's radius is worth; 0 lets it go free.
        iterations: Gauss-Newton steps, the frame turned to the new axis after each second one.

    Returns:
        The cylinder, and the robust standard deviation of the residuals in mm.
    """
    center, direction, radius = start
    scale = 0.0
    for _ in range(max(1, iterations // 2)):
        base = frame(direction)
        center = center + ((xyz - center).mean(axis=0) @ direction) * direction
        local = (xyz - center) @ np.vstack([base, direction]).T
        prior = np.array([0.0, 0.0, 0.0, 0.0, start.radius_mm])
        length = max(float(np.std(local[:, 2])), 1e-9)
        weight = np.array([1e-6, 1e-6, 1e-3 * length**2, 1e-3 * length**2, radius_weight])
        state = np.array([0.0, 0.0, 0.0, 0.0, radius])
        for _ in range(2):
            residual = np.hypot(local[:, 0] - state[0], local[:, 1] - state[1]) - state[4]
            scale = robust_std(residual) + 1e-9 * radius
            state = _step(local, state, scale, prior, weight)
        center = center + state[0] * base[0] + state[1] * base[1]
        direction = direction + state[2] * base[0] + state[3] * base[1]
        direction = direction / np.linalg.norm(direction)
        radius = abs(float(state[4]))
    fitted = Cylinder(center, direction, radius)
    residual = radial(fitted, xyz)[0] - radius
    return fitted, robust_std(residual)
