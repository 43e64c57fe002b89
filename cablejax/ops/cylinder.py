"""A gently bent cylinder fitted to a cloud, and the cloud in its coordinates: a cable unrolled."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.precision import require_float32
from cablejax.ops.varying import varying_like
from cablejax.types import Status

WIDEST = 1.0  # radius, in root-mean-square distances of the points to their centroid, from which a fit is no cable


class CylinderFrame(NamedTuple):
    """A cloud in the coordinates of the (gently bent) cylinder fitted to it, in the cloud's unit.

    Attributes:
        axial: Position along the axis, zero at the middle of the cloud `[n]`.
        angle: Angle about the axis in radians, zero where the points are centred `[n]`.
        radius: Distance from the axis `[n]`.
        fitted_radius: The cylinder's radius `[]`.
        rotation: Rows are the axis and two directions across it `[3, 3]`, right-handed.
        status: `Status.EMPTY` or `Status.DEGENERATE` where fewer than 8 points or no arc leave it undetermined.
    """

    axial: Float[Array, " n"]
    angle: Float[Array, " n"]
    radius: Float[Array, " n"]
    fitted_radius: Float[Array, ""]
    rotation: Float[Array, "3 3"]
    status: Int[Array, ""]


def cylinder_frame(
    xyz: Float[Array, "n 3"], mask: Bool[Array, " n"] | None = None, *, iterations: int = 8
) -> CylinderFrame:
    """Fit a gently bent cylinder to a cloud and give the points in its coordinates.

    Each principal direction is tried as the axis. The centre line is a parabola across the axis, the radius is one
    number, and the distances r to the surface are brought down by Gauss-Newton steps, each point weighted by
    `1 / (1 + (r / s)^2)^2`, s three times the weighted root mean square of r: outliers lose their say. The direction
    whose fit leaves the least distance is kept, and turned twice along the centre line found. Nothing is learnt here:
    gradients stop.

    Args:
        xyz: Points `[n, 3]`, of a piece of cable, any unit.
        mask: True where a row is a point `[n]`; None means all.
        iterations: Gauss-Newton steps. Static.

    Returns:
        The cylinder coordinates; zero on padding.

    Raises:
        ValueError: If the points are not float32.
    """
    require_float32(xyz=xyz)
    n = xyz.shape[0]
    mask = jnp.ones(n, dtype=bool) if mask is None else mask
    xyz = jax.lax.stop_gradient(jnp.where(mask[:, None], xyz, 0.0))
    weight = mask.astype(xyz.dtype)
    centroid, principal = principal_frame(xyz, mask)
    candidates = jnp.stack([principal, jnp.roll(principal, -1, axis=0), jnp.roll(principal, -2, axis=0)])
    scale = (
        jnp.sqrt(jnp.sum((xyz - centroid[None, :]) ** 2 * weight[:, None]) / jnp.maximum(jnp.sum(weight), 1.0)) + 1e-30
    )

    def fit(rotation: Float[Array, "3 3"]) -> tuple[Array, Array, Array, Array]:
        along, *across = jnp.moveaxis((xyz - centroid[None, :]) @ rotation.T / scale, 1, 0)
        return _fit_bent_circle(along, jnp.stack(across, axis=1), weight, iterations=iterations)

    def step(found: tuple[Array, ...], turn: Array) -> tuple[tuple[Array, ...], tuple[Array, Array, Array]]:
        least, rotation, slope = found
        trying = turn < 3
        # A tilted section is an ellipse: turn the axis along the centre line and fit again.
        new = jnp.where(trying, candidates[jnp.minimum(turn, 2)], _tilted(rotation, slope))
        line, across, radius, cost = fit(new)
        score = jnp.where(jnp.isfinite(cost) & (radius < WIDEST), cost, jnp.inf)
        take = ~trying | (turn == 0) | (score < least)
        best = (jnp.where(take, score, least), jnp.where(take, new, rotation), jnp.where(take, line[1], slope))
        return best, (across, radius, cost)

    # One loop, so that the fit is compiled once: three directions, then two turns of the best.
    start = varying_like((jnp.array(jnp.inf, xyz.dtype), principal, jnp.zeros(2, xyz.dtype)), xyz, mask)
    (_, rotation, _), last = jax.lax.scan(step, start, jnp.arange(5))
    across, radius, cost = (each[-1] for each in last)
    across, fitted = across * scale, radius * scale
    along = (xyz - centroid[None, :]) @ rotation[0]
    mean_x, mean_y = jnp.sum(across * weight[:, None], axis=0)
    angle = jnp.arctan2(across[:, 1], across[:, 0]) - jnp.arctan2(mean_y, mean_x)
    angle = jnp.mod(angle + jnp.pi, 2.0 * jnp.pi) - jnp.pi
    count = jnp.sum(mask)
    status = jnp.where(count == 0, int(Status.EMPTY), 0)
    # A nearly flat side fits a huge circle too: one such cloud in a hundred ruins a network's running statistics.
    bad = (count < 8) | ~jnp.isfinite(cost) | (radius >= WIDEST)
    status = status | jnp.where(bad, int(Status.DEGENERATE), 0)
    keep = mask & ~bad
    return CylinderFrame(
        jnp.where(keep, along, 0.0),
        jnp.where(keep, angle, 0.0),
        jnp.where(keep, jnp.linalg.norm(across, axis=1), 0.0),
        jnp.where(bad, 0.0, fitted),
        rotation,
        status,
    )


def principal_frame(
    xyz: Float[Array, "n 3"], mask: Bool[Array, " n"] | None = None
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Centroid and principal directions of a cloud, largest variance first.

    The signs are those that make the third moments along the first and the last direction positive (the open side of an
    arc); the second completes a right-handed frame.

    Returns:
        `(centroid [3], rotation [3, 3])`: rows of `rotation` are the directions.

    Raises:
        ValueError: If the points are not float32.
    """
    require_float32(xyz=xyz)
    weight = jnp.ones(xyz.shape[0], xyz.dtype) if mask is None else mask.astype(xyz.dtype)
    total = jnp.maximum(jnp.sum(weight), 1.0)
    xyz = jnp.where(weight[:, None] > 0, xyz, 0.0)
    centroid = jnp.sum(xyz * weight[:, None], axis=0) / total
    centred = (xyz - centroid[None, :]) * weight[:, None]
    _, vectors = jnp.linalg.eigh(jnp.matmul(centred.T, centred, precision=jax.lax.Precision.HIGHEST) / total)
    first, last = _skewed(centred, vectors[:, 2]), _skewed(centred, vectors[:, 0])
    return centroid, jnp.stack([first, jnp.cross(last, first), last])


def _skewed(centred: Float[Array, "n 3"], direction: Float[Array, "3"]) -> Float[Array, "3"]:
    """The direction or its opposite, whichever has the positive third moment."""
    return jnp.where(jnp.sum((centred @ direction) ** 3) < 0, -direction, direction)


def _tilted(rotation: Float[Array, "3 3"], slope: Float[Array, "2"]) -> Float[Array, "3 3"]:
    """The frame turned so that its axis follows a centre line of this slope."""
    slope = jnp.where(jnp.all(jnp.isfinite(slope)), slope, 0.0)
    axis = rotation[0] + slope[0] * rotation[1] + slope[1] * rotation[2]
    axis = axis / jnp.linalg.norm(axis)
    second = rotation[1] - (rotation[1] @ axis) * axis
    second = second / jnp.linalg.norm(second)
    return jnp.stack([axis, second, jnp.cross(axis, second)])


def _fit_bent_circle(
    along: Float[Array, " n"], across: Float[Array, "n 2"], weight: Float[Array, " n"], *, iterations: int
) -> tuple[Float[Array, "3 2"], Float[Array, "n 2"], Float[Array, ""], Float[Array, ""]]:
    """Centre line `c0 + c1 s + c2 s^2` and radius; returns line, points relative to it, radius, robust cost."""
    ones = jnp.ones_like(along)
    linear = jnp.concatenate([2.0 * across, ones[:, None]], axis=1)
    start = _least_squares(linear, jnp.sum(across**2, axis=1), weight)
    radius = jnp.sqrt(jnp.maximum(start[2] + jnp.sum(start[:2] ** 2), 1e-12))
    line = jnp.zeros((3, 2), across.dtype).at[0].set(start[:2])
    powers = jnp.stack([ones, along, along**2], axis=1)

    def step(_, state):
        line, radius, spread = state
        relative = across - powers @ line
        distance = jnp.sqrt(jnp.maximum(jnp.sum(relative**2, axis=1), 1e-12))
        residual = distance - radius
        robust = weight / (1.0 + (residual / spread) ** 2) ** 2
        spread = jnp.sqrt(jnp.sum(robust * residual**2) / jnp.maximum(jnp.sum(robust), 1e-12)) * 3.0 + 1e-6
        unit = relative / distance[:, None]
        jacobian = jnp.concatenate([powers * unit[:, :1], powers * unit[:, 1:], ones[:, None]], axis=1)
        move = _least_squares(jacobian, residual, robust)
        return line + jnp.stack([move[:3], move[3:6]], axis=1), radius + move[6], spread

    total = jnp.maximum(jnp.sum(weight), 1.0)
    relative = across - powers @ line
    first = jnp.linalg.norm(relative, axis=1) - radius
    spread = jnp.sqrt(jnp.sum(weight * first**2) / total) + 1e-6
    line, radius, spread = jax.lax.fori_loop(0, iterations, step, (line, radius, spread))
    relative = across - powers @ line
    residual = jnp.linalg.norm(relative, axis=1) - radius
    return line, relative, radius, jnp.sum(weight * jnp.minimum(jnp.abs(residual), 0.2)) / total


def _least_squares(
    rows: Float[Array, "n p"], values: Float[Array, " n"], weight: Float[Array, " n"]
) -> Float[Array, " p"]:
    """Weighted least squares by the normal equations, with a ridge of 1e-6 of their mean diagonal."""
    normal = jnp.matmul((rows * weight[:, None]).T, rows, precision=jax.lax.Precision.HIGHEST)
    ridge = 1e-6 * jnp.trace(normal) / rows.shape[1] + 1e-12
    factor = jax.lax.linalg.cholesky(normal + ridge * jnp.eye(rows.shape[1], dtype=rows.dtype))
    return jax.scipy.linalg.cho_solve((factor, True), (rows * weight[:, None]).T @ values)
