"""A gently bent cylinder fitted to weighted points, differentiable in the weights and without LAPACK: for training steps."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cablejax.types import Status

UNKNOWNS = 7  # a parabola in each of two directions across the axis, and the radius
ITERATIONS = 12
SURE = 4  # power of the weights at the start, where a far point of little weight would have much leverage
REACH = 4.5  # s below, in root mean squares: costs 2 % in the standard deviation where errors are normal
# Of normal errors of standard deviation 1: the root mean square of r so weighted, and the factor by which the usual formula
# falls short of the estimate's standard deviation (the integrals of Huber 1981, 6.3, for this weight).
SPREAD, SHORT = 0.9091, 1.0675
SQUARINGS = 9  # of a covariance: axes whose variances differ by a percent are told apart
TINY = 1e-20


class WeightedCylinder(NamedTuple):
    """A gently bent cylinder, in the cloud's unit.

    Attributes:
        radius: Of the cylinder `[]`; 0 where `status` says that there is none. Differentiable in the weights.
        std: Standard deviation of the radius by the residuals, as if they were independent and normal `[]`. Likewise.
        noise: Standard deviation of the points about the surface, likewise `[]`.
        points: Effective number of points: the sum of the weights that the fit used `[]`.
        length: Weighted standard deviation of the points along the axis `[]`.
        mean_direction: Length of the weighted mean of the unit vectors from the axis to the points `[]`: 1 where all lie on
            one side, 0 where they lie all round; sin(a/2) / (a/2) for an even arc a.
        residual: Distance of each point to the surface `[n]`, positive outside.
        status: `Status.EMPTY` without weight, `Status.DEGENERATE` where the points leave the cylinder undetermined `[]`.
    """

    radius: Float[Array, ""]
    std: Float[Array, ""]
    noise: Float[Array, ""]
    points: Float[Array, ""]
    length: Float[Array, ""]
    mean_direction: Float[Array, ""]
    residual: Float[Array, " n"]
    status: Int[Array, ""]


def weighted_cylinder(
    xyz: Float[Array, "n 3"],
    weight: Float[Array, " n"],
    *,
    radius: float | Float[Array, ""] | None = None,
    iterations: int = ITERATIONS,
) -> WeightedCylinder:
    """Fit a gently bent cylinder to weighted points.

    The axis follows a parabola over the weighted principal direction; distances are measured across its tangent. The
    start is an algebraic circle about the parabola through the points, of which those of the largest weights count.
    Gauss-Newton steps then minimise the weighted squares of the distances r to the surface, each weight multiplied by
    `1 / (1 + (r / s)^2)^2`, s 4.5 times the root mean square of r so weighted. Gradients are those of the minimum: the
    steps up to it carry none, one more from there carries the whole (the implicit function theorem with Gauss-Newton's
    second derivatives).

    Args:
        xyz: Points `[n, 3]` of a piece of cable that is longer than it is wide, any unit. Gradients stop here.
        weight: Weights `[n]`, 0 or more; 0 leaves a point out.
        radius: Of the cylinder, where it is known and only the axis is not; None fits it too.
        iterations: Gauss-Newton steps. Static.

    Returns:
        The cylinder, its uncertainty and how the points lie on it.
    """
    still = jax.lax.stop_gradient(weight)
    xyz = jax.lax.stop_gradient(jnp.where(still[:, None] > 0, xyz, 0.0))
    sure = (still / jnp.maximum(jnp.max(still), TINY)) ** SURE
    centroid, rotation = principal_axes(xyz, sure)
    turned = (xyz - centroid[None, :]) @ rotation.T
    total = jnp.sum(still)
    scale = jnp.sqrt(jnp.sum(still[:, None] * turned**2) / jnp.maximum(total, TINY)) + TINY
    along, across = turned[:, 0] / scale, turned[:, 1:] / scale
    start = _start(along, across, sure)
    start = start if radius is None else start.at[6].set(radius / scale)
    free = jnp.ones(UNKNOWNS, xyz.dtype) if radius is None else jnp.ones(UNKNOWNS, xyz.dtype).at[6].set(0.0)
    spread = REACH * _rms(sure, _distances(start, along, across)[0])

    def step(state: tuple[Array, Array], _) -> tuple[tuple[Array, Array], None]:
        theta, spread = state
        residual, jacobian = _distances(theta, along, across)
        robust = still * _robust(residual, spread)
        move, _ = _solve(*_normal(jacobian * free[None, :], residual, robust))
        return (theta + move, REACH * _rms(robust, residual)), None

    (theta, spread), _ = jax.lax.scan(step, (start, spread), None, length=iterations)
    count = jnp.sum(still * _robust(_distances(theta, along, across)[0], spread))
    empty = total <= 0
    # A radius beyond the cloud's own size is a flat side's: nothing here says where its axis is.
    bad = ~jnp.isfinite(theta).all() | (theta[6] >= 1.0) | (theta[6] <= 0.0) | (count <= UNKNOWNS + 1)
    theta, spread = jax.lax.stop_gradient((jnp.where(bad, start, theta), jnp.where(bad, 1.0, spread)))

    residual, jacobian = _distances(theta, along, across)
    robust = weight * jax.lax.stop_gradient(_robust(residual, spread))
    move, inverse = _solve(*_normal(jacobian * free[None, :], residual, robust))
    used = jnp.sum(robust)
    noise_sq = jnp.sum(robust * residual**2) / jnp.maximum(used - UNKNOWNS, 1.0)
    variance = jnp.maximum(noise_sq * inverse[6, 6], 1e-16)  # the root has no gradient at 0
    share = robust / jnp.maximum(used, TINY)
    mean = jnp.sum(share * along)
    direction = share @ jacobian[:, (0, 3)]
    return WeightedCylinder(
        radius=jnp.where(bad, 0.0, (theta[6] + move[6]) * scale),
        std=SHORT * jnp.sqrt(variance) * scale,
        noise=jnp.sqrt(jnp.maximum(noise_sq, 1e-16)) / SPREAD * scale,
        points=used,
        length=jnp.sqrt(jnp.maximum(jnp.sum(share * (along - mean) ** 2), 1e-12)) * scale,
        mean_direction=jnp.sqrt(jnp.maximum(jnp.sum(direction**2), 1e-12)),
        residual=residual * scale,
        status=jnp.where(empty, int(Status.EMPTY), 0) | jnp.where(bad, int(Status.DEGENERATE), 0),
    )


def principal_axes(
    xyz: Float[Array, "n 3"], weight: Float[Array, " n"]
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Weighted centroid and principal directions, largest variance first, as `cablejax.ops.principal_frame` signs them.

    The covariance's powers leave the projector onto the largest axis, those of its adjugate onto the smallest; where two
    variances agree to within a percent any mixture of their axes comes out.

    Returns:
        `(centroid [3], rotation [3, 3])`: rows of `rotation` are the directions, right-handed.
    """
    total = jnp.maximum(jnp.sum(weight), TINY)
    centroid = jnp.sum(xyz * weight[:, None], axis=0) / total
    centred = jnp.where(weight[:, None] > 0, xyz - centroid[None, :], 0.0)
    covariance = jnp.matmul((centred * weight[:, None]).T, centred, precision=jax.lax.Precision.HIGHEST)
    covariance = covariance / jnp.maximum(jnp.trace(covariance), TINY) + 1e-7 * jnp.eye(3, dtype=xyz.dtype)
    a, b, c = covariance
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    first, last = _dominant(covariance), _dominant(adjugate)
    last = last - (last @ first) * first
    norm = jnp.linalg.norm(last)
    other = jnp.cross(first, jnp.roll(first, 1) + jnp.array([0.0, 0.0, 1e-3], xyz.dtype))
    last = jnp.where(norm > 1e-3, last / jnp.maximum(norm, TINY), other / jnp.maximum(jnp.linalg.norm(other), TINY))

    def signed(direction: Array) -> Array:
        return jnp.where(jnp.sum(weight * (centred @ direction) ** 3) < 0, -direction, direction)

    first, last = signed(first), signed(last)
    return centroid, jnp.stack([first, jnp.cross(last, first), last])


def _dominant(matrix: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Unit eigenvector of the largest eigenvalue of a positive matrix."""

    def square(_, power: Array) -> Array:
        power = power / jnp.maximum(jnp.trace(power), TINY)
        return power @ power

    power = jax.lax.fori_loop(0, SQUARINGS, square, matrix)
    column = power[jnp.argmax(jnp.diagonal(power))]
    return column / jnp.maximum(jnp.linalg.norm(column), TINY)


def _start(along: Float[Array, " n"], across: Float[Array, "n 2"], weight: Float[Array, " n"]) -> Float[Array, " 7"]:
    """The parabola through the points, moved by the algebraic circle that fits them about it (Kasa 1976), with its radius."""
    powers = jnp.stack([jnp.ones_like(along), along, along**2], axis=1)
    line = _solve(*_normal(powers, across, weight))[0]
    rest = across - powers @ line
    rows = jnp.concatenate([2.0 * rest, jnp.ones_like(rest[:, :1])], axis=1)
    y, z, left = _solve(*_normal(rows, jnp.sum(rest**2, axis=1), weight))[0]
    line = line.at[0].add(jnp.stack([y, z]))
    return jnp.concatenate([line[:, 0], line[:, 1], jnp.sqrt(jnp.maximum(left + y * y + z * z, 1e-12))[None]])


def _distances(
    theta: Float[Array, " 7"], along: Float[Array, " n"], across: Float[Array, "n 2"]
) -> tuple[Float[Array, " n"], Float[Array, "n 7"]]:
    """Signed distance of each point to the surface `[n]`, and what moves it: its negative derivatives `[n, 7]`."""
    powers = jnp.stack([jnp.ones_like(along), along, along**2], axis=1)
    line = jnp.stack([theta[:3], theta[3:6]], axis=1)
    relative = across - powers @ line
    slope = line[1][None, :] + 2.0 * along[:, None] * line[2][None, :]
    # what of the offset lies along the tangent (1, slope) is no distance from the axis
    lean = jnp.sum(relative * slope, axis=1) / (1.0 + jnp.sum(slope**2, axis=1))
    offset = relative - lean[:, None] * slope
    distance = jnp.sqrt(jnp.maximum(jnp.sum(offset**2, axis=1) + lean**2, 1e-12))
    unit = offset / distance[:, None]
    ones = jnp.ones_like(along)[:, None]
    return distance - theta[6], jnp.concatenate([powers * unit[:, :1], powers * unit[:, 1:], ones], axis=1)


def _robust(residual: Array, spread: Array) -> Array:
    return 1.0 / (1.0 + (residual / spread) ** 2) ** 2


def _rms(weight: Array, residual: Array) -> Array:
    return jnp.sqrt(jnp.sum(weight * residual**2) / jnp.maximum(jnp.sum(weight), TINY)) + 1e-6


def _normal(rows: Array, values: Array, weight: Array) -> tuple[Array, Array]:
    """Both sides of the normal equations of `rows [n, m] @ x = values [n, ...]`."""
    product = partial(jnp.matmul, (rows * weight[:, None]).T, precision=jax.lax.Precision.HIGHEST)
    return product(rows), product(values)


def _solve(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Solution and inverse `[m, m]` of a positive system by Gauss-Jordan steps, with a ridge of 1e-6 of its mean diagonal."""
    m = matrix.shape[0]
    eye = jnp.eye(m, dtype=matrix.dtype)
    matrix = matrix + (1e-6 * jnp.trace(matrix) / m + 1e-12) * eye
    table = jnp.concatenate([matrix, eye], axis=1)

    def eliminate(table: Array, i: Array) -> tuple[Array, None]:
        own = jax.lax.dynamic_index_in_dim(table, i, keepdims=False)
        own = own / jax.lax.dynamic_index_in_dim(own, i, keepdims=False)
        column = jax.lax.dynamic_index_in_dim(table, i, axis=1, keepdims=False)
        here = jnp.arange(m) == i
        return table - jnp.where(here, column - 1.0, column)[:, None] * own[None, :], None

    inverse = jax.lax.scan(eliminate, table, jnp.arange(m))[0][:, m:]
    return inverse @ right, inverse
