"""Weighted planes and quadrics through many neighbourhoods at once, from moments summed slot by slot."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.slots import sum_over_slots

TINY = float(jnp.finfo(jnp.float32).tiny)
RIDGE = 1e-6  # on terms scaled to size one: keeps collinear neighbourhoods solvable, moves others by less than rounding
TERMS = {1: 3, 2: 6}  # coefficients of a plane and a quadric

Sample = Callable[[Int[Array, " m"], Bool[Array, " m"]], tuple[Float[Array, " m"], Float[Array, "3 m"]]]
"""From the neighbours in one slot to their weights `[m]`, zero where there is none, and offsets from the centre `[3, m]`."""


class Frame(NamedTuple):
    """Where the neighbours of each centre lie, and which way their surface faces.

    Attributes:
        normal: Unit normal `[3, m]`, of either sign.
        mean: Weighted mean of the offsets `[3, m]`.
        size: Root of their weighted mean square `[m]`.
        least: Weighted variance along the normal `[m]`.
        total: Sum of the weights `[m]`.
    """

    normal: Float[Array, "3 m"]
    mean: Float[Array, "3 m"]
    size: Float[Array, " m"]
    least: Float[Array, " m"]
    total: Float[Array, " m"]


class SurfaceFit(NamedTuple):
    """A height field over each centre's tangent plane.

    Attributes:
        normal: Unit normal `[3, m]`, of either sign.
        height: Height of the surface above the centre `[m]`, along the normal.
        bend: Sum of its two second derivatives there `[m]`, the sum of the principal curvatures; 0 for planes.
        noise: Standard deviation of the neighbours from the surface along the normal `[m]`, fitted parameters allowed for.
        leverage: What a height of one in the centre itself would add to `height`, per unit of its weight `[m]`.
        coefficients: Of 1, u, v, u^2, uv, v^2 in the tangent plane `[3 or 6, m]`; lengths in units of `size`.
        size: Unit of length of the coefficients `[m]`.
    """

    normal: Float[Array, "3 m"]
    height: Float[Array, " m"]
    bend: Float[Array, " m"]
    noise: Float[Array, " m"]
    leverage: Float[Array, " m"]
    coefficients: Float[Array, "t m"]
    size: Float[Array, " m"]


def fit_surface(sample: Sample, neighbors: Int[Array, "k m"], *, order: int) -> SurfaceFit:
    """Fit a plane (order 1) or a quadric (order 2) to neighbours by weighted least squares.

    Args:
        sample: Weights and offsets of the neighbours in a slot, any unit.
        neighbors: Rows of the neighbours `[k, m]`, -1 where there is none.
        order: 1 or 2. Static.

    Returns:
        Normals, heights, bends and noise; zero heights where all weights are zero.
    """
    return fit_heights(sample, neighbors, fit_frame(sample, neighbors), order=order)


def fit_frame(sample: Sample, neighbors: Int[Array, "k m"]) -> Frame:
    """Mean, size and normal of each neighbourhood."""

    def moments(rows: Array, near: Array) -> tuple[Array, Array, Array]:
        weight, (x, y, z) = sample(rows, near)
        first, square = jnp.stack([x, y, z]), jnp.stack([x * x, y * y, z * z, x * y, y * z, z * x])
        return weight, weight[None] * first, weight[None] * square

    total, first, square = sum_over_slots(neighbors, moments)
    share = 1.0 / jnp.maximum(total, TINY)
    mean, square = first * share[None], square * share[None]
    x, y, z = mean
    covariance = square - jnp.stack([x * x, y * y, z * z, x * y, y * z, z * x])
    normal, least = least_axis(covariance)
    return Frame(normal, mean, jnp.sqrt(jnp.maximum(square[:3].sum(axis=0), TINY)), least, total)


def fit_heights(sample: Sample, neighbors: Int[Array, "k m"], frame: Frame, *, order: int) -> SurfaceFit:
    """Fit the heights over the tangent planes of given frames; see `fit_surface`."""
    first, second = tangents(frame.normal)
    terms = TERMS[order]

    def moments(rows: Array, near: Array) -> tuple[Array, ...]:
        weight, offset = sample(rows, near)
        u, v, height = (along(axis, offset) / frame.size for axis in (first, second, frame.normal))
        basis = monomials(u, v)[:terms]
        weighted = [weight * t for t in basis]
        matrix = [weighted[i] * basis[j] for i in range(terms) for j in range(i + 1)]
        right = [w * height for w in weighted]
        return jnp.stack(matrix), jnp.stack(right), weight * height * height, weight * weight

    matrix, right, square, squared_weight = sum_over_slots(neighbors, moments)
    share = 1.0 / jnp.maximum(matrix[0], TINY)
    lower = _cholesky(list(matrix * share[None]), terms)
    right = list(right * share[None])
    solution = _solve(lower, right)
    one, none = jnp.ones_like(share), jnp.zeros_like(share)
    leverage = _solve(lower, [one] + [none] * (terms - 1))[0] * share
    explained = sum(c * r for c, r in zip(solution, right, strict=True))
    # Weights w that sum to one count as 1 / sum(w^2) neighbours, of which the coefficients use up some.
    free = jnp.maximum(1.0 - terms * squared_weight * share * share, 0.2)
    rest = jnp.maximum(square * share - explained, TINY)
    bend = 2.0 * (solution[3] + solution[5]) / frame.size if order == 2 else none
    return SurfaceFit(
        frame.normal, solution[0] * frame.size, bend, jnp.sqrt(rest / free) * frame.size, leverage,
        jnp.stack(solution), frame.size,
    )  # fmt: skip


def residual(fit: SurfaceFit) -> Callable[[Float[Array, "3 m"]], tuple[Array, Array]]:
    """From points to their height above their surface `[m]` and squared distance from the centre in the tangent plane."""
    first, second = tangents(fit.normal)

    def above(offset: Float[Array, "3 m"]) -> tuple[Array, Array]:
        u, v = along(first, offset) / fit.size, along(second, offset) / fit.size
        basis = monomials(u, v)[: fit.coefficients.shape[0]]
        surface = sum(c * t for c, t in zip(fit.coefficients, basis, strict=True)) * fit.size
        return along(fit.normal, offset) - surface, (u * u + v * v) * jnp.square(fit.size)

    return above


def monomials(u: Array, v: Array) -> list[Array]:
    """1, u, v, u^2, uv, v^2."""
    return [jnp.ones_like(u), u, v, u * u, u * v, v * v]


def along(axis: Float[Array, "3 m"], offset: Float[Array, "3 m"]) -> Float[Array, " m"]:
    """Products of vectors pair by pair."""
    return axis[0] * offset[0] + axis[1] * offset[1] + axis[2] * offset[2]


def least_axis(covariance: Float[Array, "6 m"]) -> tuple[Float[Array, "3 m"], Float[Array, " m"]]:
    """Unit eigenvector and value of the smallest eigenvalue of matrices xx, yy, zz, xy, yz, zx, without LAPACK's loop.

    The adjugate has the same eigenvectors with the products of the other two eigenvalues: squaring it again and again
    leaves the projector onto the wanted one. Where the two smallest agree to a percent, any mixture of them comes out.
    """
    trace = jnp.maximum(covariance[:3].sum(axis=0), TINY)
    xx, yy, zz, xy, yz, zx = covariance / trace[None] + jnp.asarray([RIDGE] * 3 + [0.0] * 3)[:, None]
    power = jnp.stack(
        [
            yy * zz - yz * yz,
            zz * xx - zx * zx,
            xx * yy - xy * xy,
            yz * zx - xy * zz,
            zx * xy - yz * xx,
            xy * yz - zx * yy,
        ]
    )
    for _ in range(9):
        xx, yy, zz, xy, yz, zx = power / jnp.maximum(power[:3].sum(axis=0), TINY)[None]
        power = jnp.stack(
            [
                xx * xx + xy * xy + zx * zx, xy * xy + yy * yy + yz * yz, zx * zx + yz * yz + zz * zz,
                xx * xy + xy * yy + zx * yz, xy * zx + yy * yz + yz * zz, zx * xx + yz * xy + zz * zx,
            ]
        )  # fmt: skip
    xx, yy, zz, xy, yz, zx = power
    columns = jnp.stack([jnp.stack([xx, xy, zx]), jnp.stack([xy, yy, yz]), jnp.stack([zx, yz, zz])])
    best = jnp.argmax(power[:3], axis=0)
    column = jnp.sum(jnp.where(jnp.arange(3)[:, None, None] == best[None, None, :], columns, 0.0), axis=0)
    normal = column / jnp.sqrt(jnp.maximum(jnp.square(column).sum(axis=0), TINY))[None]
    x, y, z = normal
    xx, yy, zz, xy, yz, zx = covariance
    value = x * x * xx + y * y * yy + z * z * zz + 2.0 * (x * y * xy + y * z * yz + z * x * zx)
    return normal, jnp.maximum(value, 0.0)


def tangents(normal: Float[Array, "3 m"]) -> tuple[Float[Array, "3 m"], Float[Array, "3 m"]]:
    """Two unit vectors across each unit normal, after Duff et al. (2017); it has no branch near the poles."""
    x, y, z = normal
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), jnp.stack([b, sign + y * y * a, -y])


def _cholesky(matrix: list[Array], m: int) -> list[list[Array]]:
    """Lower factors of matrices given by their lower triangles row by row, unrolled."""
    lower: list[list[Array]] = [[] for _ in range(m)]
    entries = iter(matrix)
    for i in range(m):
        for j in range(i + 1):
            entry = next(entries) + (RIDGE if i == j else 0.0)
            for p in range(j):
                entry = entry - lower[i][p] * lower[j][p]
            lower[i].append(jnp.sqrt(jnp.maximum(entry, RIDGE * RIDGE)) if i == j else entry / lower[j][j])
    return lower


def _solve(lower: list[list[Array]], right: list[Array]) -> list[Array]:
    """Solutions of the factorised systems."""
    m, x = len(lower), list(right)
    for i in range(m):
        for p in range(i):
            x[i] = x[i] - lower[i][p] * x[p]
        x[i] = x[i] / lower[i][i]
    for i in reversed(range(m)):
        for p in range(i + 1, m):
            x[i] = x[i] - lower[p][i] * x[p]
        x[i] = x[i] / lower[i][i]
    return x
