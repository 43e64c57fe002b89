"""Weighted planes and quadrics through many neighbourhoods at once, from moments summed slot by slot."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.factors import TINY, backward, cholesky, forward, sum_of_squares
from cablejax.ops.slots import Vector, along, sum_over_slots

RIDGE = (
    1e-6  # on covariances scaled to trace one: an axis of collinear points, which moves others by less than rounding
)
TERMS = {1: 3, 2: 6}  # coefficients of a plane and a quadric
EXPONENTS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # of u and v in them
THIN = (
    1e-4  # least spread across a neighbourhood, squared, of its mean square distance: one part in a hundred is a line
)
FAINT = (
    1e-6  # weight that counts as none: in units of a size that it shrinks, the fourth powers of such a point overflow
)
SQUARINGS = 9  # of the adjugate: the power of 512
ALONE = 0.9  # share of its own height in a fit from which on a point is not smoothed but interpolated

Sample = Callable[[Int[Array, " m"], Bool[Array, " m"]], tuple[Float[Array, " m"], Vector]]
"""From the neighbours in one slot to their weights `[m]`, zero where there is none, and offsets from the centre, each `[m]`."""


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
    """A height field over each centre's tangent plane, of the highest degree that its neighbours determine.

    Attributes:
        normal: Unit normal `[3, m]`, of either sign.
        height: Height of the surface above the centre `[m]`, along the normal.
        bend: Sum of its two second derivatives there `[m]`, the sum of the principal curvatures; 0 for planes.
        noise: Standard deviation of the neighbours from the surface along the normal `[m]`, fitted parameters allowed for.
        leverage: What a height of one in the centre itself would add to `height`, per unit of its weight `[m]`.
        coefficients: Of 1, u, v, u^2, uv, v^2 in the tangent plane, 3 or 6, each `[m]`; lengths in units of `size`.
        size: Unit of length of the coefficients `[m]`.
        degree: 2 a quadric, 1 a plane, 0 where the neighbours lie at one place or along a line `[m]` int32; `height` is
            then that of their mean.
    """

    normal: Float[Array, "3 m"]
    height: Float[Array, " m"]
    bend: Float[Array, " m"]
    noise: Float[Array, " m"]
    leverage: Float[Array, " m"]
    coefficients: Vector
    size: Float[Array, " m"]
    degree: Int[Array, " m"]


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

    def moments(rows: Array, near: Array) -> tuple[Array, ...]:
        weight, (x, y, z) = _counted(sample, rows, near)
        products = (x, y, z, x * x, y * y, z * z, x * y, y * z, z * x)
        return (weight, *(weight * each for each in products))

    total, *sums = sum_over_slots(neighbors, moments)
    share = inverse(total)
    means = jnp.stack(sums) * share[None]
    mean, square = means[:3], means[3:]
    x, y, z = mean
    covariance = square - jnp.stack([x * x, y * y, z * z, x * y, y * z, z * x])
    normal, least = least_axis(covariance)
    return Frame(normal, mean, jnp.sqrt(jnp.maximum(square[:3].sum(axis=0), TINY)), least, total)


def fit_heights(sample: Sample, neighbors: Int[Array, "k m"], frame: Frame, *, order: int) -> SurfaceFit:
    """Fit the heights over the tangent planes of given frames; see `fit_surface`.

    A quadric counts as determined if none of its terms is, at the neighbours, all but a mixture of those before it
    (`PIVOT`), its height rests on more than the point itself (`ALONE`), and it passes no farther from the centre than
    the neighbours lie. Otherwise the plane of the same normal equations is taken, and where the neighbours' spread
    across the normal is that of a line (`THIN`), their mean.
    """
    first, second = tangents(frame.normal)
    terms = TERMS[order]

    def moments(rows: Array, near: Array) -> tuple[Any, ...]:
        weight, offset = _counted(sample, rows, near)
        u, v, height = (along(axis, offset) / frame.size for axis in (first, second, frame.normal))
        products = {(a, b): weight * u**a * v**b for a, b in _products(terms)}
        right = [weight * height * t for t in monomials(u, v)[:terms]]
        return products, right, weight * height * height, weight * weight

    products, right, square, squared_weight = sum_over_slots(neighbors, moments)
    share = inverse(products[0, 0])
    matrix = [
        products[a + c, b + d] * share for i, (a, b) in enumerate(EXPONENTS[:terms]) for c, d in EXPONENTS[: i + 1]
    ]
    system = _Moments(matrix, [each * share for each in right], square * share, squared_weight * share**2)
    lower, pivots, distinct = cholesky(system.matrix, terms)
    fits = _Factored(lower, forward(lower, system.right), forward(lower, [jnp.ones_like(share)]))
    flat = (jnp.minimum(pivots[1], pivots[2]) > THIN) & distinct[1] & distinct[2] & (products[0, 0] > 0)
    mean = _mean_height(system)
    fit = _choose(flat, _polynomial(fits, system, 3), mean)
    degree = flat.astype(jnp.int32)
    if order == 2:
        quadric = _polynomial(fits, system, terms)
        near = jnp.abs(quadric.coefficients[0]) <= 1.0  # in units of the neighbours' mean square distance
        curved = flat & distinct[3] & distinct[4] & distinct[5] & near & (quadric.leverage * system.squared < ALONE)
        fit = _choose(curved, quadric, fit._replace(coefficients=fit.coefficients + [jnp.zeros_like(share)] * 3))
        degree = degree + curved.astype(jnp.int32)
    solution, none = fit.coefficients, jnp.zeros_like(share)
    bend = 2.0 * (solution[3] + solution[5]) / frame.size if order == 2 else none
    return SurfaceFit(
        frame.normal, solution[0] * frame.size, bend, jnp.sqrt(fit.variance) * frame.size, fit.leverage * share,
        tuple(solution), frame.size, degree,
    )  # fmt: skip


def flat_fit(frame: Frame, *, order: int) -> SurfaceFit:
    """The tangent planes through the centres, in the shape of a fit."""
    none = jnp.zeros_like(frame.size)
    return SurfaceFit(frame.normal, none, none, none, none, (none,) * TERMS[order], frame.size, none.astype(jnp.int32))


def without_faint(weight: Float[Array, " m"]) -> Float[Array, " m"]:
    """Kernel weights, zero where they are too small to count."""
    return jnp.where(weight > FAINT, weight, 0.0)


def _counted(sample: Sample, rows: Array, near: Array) -> tuple[Float[Array, " m"], Vector]:
    """A sample whose points without weight lie at the centre: far from a small neighbourhood their powers are infinite."""
    weight, offset = sample(rows, near)
    return weight, tuple(jnp.where(weight > 0, each, 0.0) for each in offset)


class _Moments(NamedTuple):
    """Normal equations with weights that sum to one.

    Attributes:
        matrix: Lower triangles row by row, each entry `[m]`.
        right: Right sides, each `[m]`.
        square: Mean square of the heights `[m]`.
        squared: Sum of the squared weights `[m]`: one over the number of neighbours that they amount to.
    """

    matrix: list[Array]
    right: list[Array]
    square: Float[Array, " m"]
    squared: Float[Array, " m"]


class _Polynomial(NamedTuple):
    """A fit in scaled lengths: coefficients, squared noise and the leverage of a centre with all the weight."""

    coefficients: list[Array]
    variance: Float[Array, " m"]
    leverage: Float[Array, " m"]


class _Factored(NamedTuple):
    """Factors of the normal equations, and what both degrees have of them: those of a plane come first.

    Attributes:
        lower: Lower factors row by row.
        right: Right sides after forward substitution; their squares add up to what the terms explain.
        centre: The same of a height of one in the centre; its squares add up to the leverage.
    """

    lower: list[list[Array]]
    right: list[Array]
    centre: list[Array]


def _polynomial(fits: _Factored, system: _Moments, terms: int) -> _Polynomial:
    """The fit of the first so many terms."""
    solution = backward(fits.lower, fits.right[:terms])
    variance = _variance(sum_of_squares(fits.right[:terms]), terms, system)
    return _Polynomial(solution, variance, sum_of_squares(fits.centre[:terms]))


def _mean_height(system: _Moments) -> _Polynomial:
    """The mean of the heights, as a plane across the normal."""
    mean, none = system.right[0], jnp.zeros_like(system.square)
    return _Polynomial([mean, none, none], _variance(mean * mean, 1, system), jnp.ones_like(mean))


def _variance(explained: Float[Array, " m"], terms: int, system: _Moments) -> Float[Array, " m"]:
    """Mean square that a fit leaves, over the share of the neighbours that its coefficients do not use up."""
    free = jnp.maximum(1.0 - terms * system.squared, 0.2)
    return jnp.maximum(system.square - explained, TINY) / free


def _choose(condition: Bool[Array, " m"], chosen: _Polynomial, other: _Polynomial) -> _Polynomial:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, other)


def residual(fit: SurfaceFit) -> Callable[[Vector], tuple[Array, Array]]:
    """From points to their height above their surface `[m]` and squared distance from the centre in the tangent plane."""
    first, second = tangents(fit.normal)

    def above(offset: Vector) -> tuple[Array, Array]:
        u, v = along(first, offset) / fit.size, along(second, offset) / fit.size
        surface = along(fit.coefficients, tuple(monomials(u, v)[: len(fit.coefficients)])) * fit.size
        return along(fit.normal, offset) - surface, (u * u + v * v) * jnp.square(fit.size)

    return above


def inverse(weight: Float[Array, " m"]) -> Float[Array, " m"]:
    """One over each sum of weights, 0 where there is none; double where, as the square of 1 / TINY overflows in its gradient."""
    there = weight > TINY**0.5
    return jnp.where(there, 1.0 / jnp.where(there, weight, 1.0), 0.0)


def _products(terms: int) -> list[tuple[int, int]]:
    """Exponents of the products of any two terms."""
    return sorted({(a + c, b + d) for a, b in EXPONENTS[:terms] for c, d in EXPONENTS[:terms]})


def monomials(u: Array, v: Array) -> list[Array]:
    """1, u, v, u^2, uv, v^2."""
    return [u**a * v**b for a, b in EXPONENTS]


@jax.custom_jvp
def least_axis(covariance: Float[Array, "6 m"]) -> tuple[Float[Array, "3 m"], Float[Array, " m"]]:
    """Unit eigenvector and value of the smallest eigenvalue of matrices xx, yy, zz, xy, yz, zx, without LAPACK's loop.

    The adjugate has the same eigenvectors with the products of the other two eigenvalues: squaring it again and again
    leaves the projector onto the wanted one. Where the two smallest agree to a percent, any mixture of them comes out.

    Its gradient is that of perturbation theory, bounded where the axis is hardly determined (`RIDGE`).
    """
    trace = covariance[:3].sum(axis=0)
    trace = jnp.where(trace > TINY**0.5, trace, 1.0)
    xx, yy, zz, xy, yz, zx = (
        covariance / trace[None] + jnp.asarray([RIDGE] * 3 + [0.0] * 3, dtype=covariance.dtype)[:, None]
    )
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
    power = lax.fori_loop(0, SQUARINGS, _squared, power)
    xx, yy, zz, xy, yz, zx = power
    columns = jnp.stack([jnp.stack([xx, xy, zx]), jnp.stack([xy, yy, yz]), jnp.stack([zx, yz, zz])])
    best = jnp.argmax(power[:3], axis=0)
    column = jnp.sum(jnp.where(jnp.arange(3)[:, None, None] == best[None, None, :], columns, 0.0), axis=0)
    normal = column / jnp.sqrt(jnp.maximum(jnp.square(column).sum(axis=0), TINY))[None]
    x, y, z = normal
    xx, yy, zz, xy, yz, zx = covariance
    value = x * x * xx + y * y * yy + z * z * zz + 2.0 * (x * y * xy + y * z * yz + z * x * zx)
    return normal, jnp.maximum(value, 0.0)


def _squared(_: Any, power: Float[Array, "6 m"]) -> Float[Array, "6 m"]:
    """Squares of symmetric matrices, each scaled to trace one before."""
    xx, yy, zz, xy, yz, zx = power / jnp.maximum(power[:3].sum(axis=0), TINY)[None]
    return jnp.stack(
        [
            xx * xx + xy * xy + zx * zx, xy * xy + yy * yy + yz * yz, zx * zx + yz * yz + zz * zz,
            xx * xy + xy * yy + zx * yz, xy * zx + yy * yz + yz * zz, zx * xx + yz * xy + zz * zx,
        ]
    )  # fmt: skip


@least_axis.defjvp
def _least_axis_jvp(primals: tuple[Array], tangents_in: tuple[Array]) -> tuple[tuple, tuple]:
    """The axis turns by `(C - value)^+ dC axis`, across itself."""
    (covariance,), (change,) = primals, tangents_in
    normal, least = least_axis(covariance)
    trace = covariance[:3].sum(axis=0)
    trace = jnp.where(trace > TINY**0.5, trace, 1.0)
    first, second = tangents(normal)
    stiff, moved = apply_symmetric(covariance / trace[None], first), apply_symmetric(covariance / trace[None], second)
    level = least / trace - RIDGE
    a, b, c = along(first, stiff) - level, along(first, moved), along(second, moved) - level
    force = apply_symmetric(change / trace[None], normal)
    p, q = along(first, force), along(second, force)
    # Both eigenvalues left are at least RIDGE in exact numbers; rounding must not make their product vanish.
    share = 1.0 / jnp.maximum(a * c - b * b, RIDGE * RIDGE)
    turn = -((c * p - b * q) * share)[None] * first - ((a * q - b * p) * share)[None] * second
    return (normal, least), (turn, along(normal, force) * trace)


def apply_symmetric(matrix: Float[Array, "6 m"], vector: Float[Array, "3 m"]) -> Float[Array, "3 m"]:
    """Products of symmetric matrices xx, yy, zz, xy, yz, zx with vectors."""
    xx, yy, zz, xy, yz, zx = matrix
    x, y, z = vector
    return jnp.stack([xx * x + xy * y + zx * z, xy * x + yy * y + yz * z, zx * x + yz * y + zz * z])


def tangents(normal: Float[Array, "3 m"]) -> tuple[Float[Array, "3 m"], Float[Array, "3 m"]]:
    """Two unit vectors across each unit normal, after Duff et al. (2017); it has no branch near the poles."""
    x, y, z = normal
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), jnp.stack([b, sign + y * y * a, -y])
