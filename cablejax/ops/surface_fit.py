"""Weighted planes and quadrics through the neighbourhoods of many points at once, in each one's own frame."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

TINY = float(jnp.finfo(jnp.float32).tiny)
RIDGE = 1e-6  # on terms scaled to size one: keeps collinear neighbourhoods solvable, moves others by less than rounding


class SurfaceFit(NamedTuple):
    """A height field over each point's tangent plane.

    Attributes:
        normal: Unit normal `[n, 3]`, of either sign.
        height: Height of the surface above the point `[n]`, along the normal.
        bend: Sum of its two second derivatives there `[n]`, the sum of the principal curvatures; 0 for planes.
        noise: Standard deviation of the neighbours from the surface along the normal `[n]`, fitted parameters allowed for.
    """

    normal: Float[Array, "n 3"]
    height: Float[Array, " n"]
    bend: Float[Array, " n"]
    noise: Float[Array, " n"]


def fit_surface(offsets: Float[Array, "n k 3"], weight: Float[Array, "n k"], *, order: int) -> SurfaceFit:
    """Fit a plane (order 1) or a quadric (order 2) to neighbours by weighted least squares.

    Args:
        offsets: Neighbours relative to their point `[n, k, 3]`, any unit.
        weight: Their weights `[n, k]`, zero for neighbours that are missing.
        order: 1 or 2. Static.

    Returns:
        Normals, heights, bends and noise; zero heights where all weights are zero.
    """
    total = jnp.maximum(weight.sum(axis=1), TINY)
    weight = weight / total[:, None]
    mean = (weight[:, :, None] * offsets).sum(axis=1)
    normal = least_axis(_covariance(offsets - mean[:, None, :], weight))
    above = jnp.sum(offsets * normal[:, None, :], axis=2)
    if order == 1:
        height = jnp.sum(mean * normal, axis=1)
        noise = _noise(above - height[:, None], weight, parameters=3)
        return SurfaceFit(normal, height, jnp.zeros_like(height), noise)
    first, second = _tangents(normal)
    u = jnp.sum(offsets * first[:, None, :], axis=2)
    v = jnp.sum(offsets * second[:, None, :], axis=2)
    size = jnp.sqrt(jnp.maximum(jnp.sum(weight * (u * u + v * v), axis=1), TINY))
    u, v, above = u / size[:, None], v / size[:, None], above / size[:, None]
    terms = (jnp.ones_like(u), u, v, u * u, u * v, v * v)
    solution = _least_squares(terms, above, weight)
    residual = above - sum(c[:, None] * t for c, t in zip(solution, terms, strict=True))
    noise = _noise(residual, weight, parameters=6) * size
    return SurfaceFit(normal, solution[0] * size, 2.0 * (solution[3] + solution[5]) / size, noise)


def least_axis(matrix: Float[Array, "n 3 3"]) -> Float[Array, "n 3"]:
    """Unit eigenvector of the smallest eigenvalue of symmetric positive matrices, without LAPACK's one-by-one loop.

    The adjugate has the same eigenvectors with the products of the other two eigenvalues: squaring it again and again
    leaves the projector onto the wanted one. Where the two smallest agree to a percent, any mixture of them comes out.
    """
    trace = jnp.maximum(jnp.trace(matrix, axis1=1, axis2=2), TINY)[:, None, None]
    scaled = matrix / trace + RIDGE * jnp.eye(3)[None]
    x, y, z = scaled[:, :, 0], scaled[:, :, 1], scaled[:, :, 2]
    power = jnp.stack([jnp.cross(y, z), jnp.cross(z, x), jnp.cross(x, y)], axis=1)
    for _ in range(9):
        power = power / jnp.maximum(jnp.trace(power, axis1=1, axis2=2), TINY)[:, None, None]
        power = jnp.sum(power[:, :, :, None] * power[:, None, :, :], axis=2)
    length = jnp.sum(jnp.square(power), axis=1)
    best = jnp.argmax(length, axis=1)
    column = jnp.take_along_axis(power, best[:, None, None], axis=2)[:, :, 0]
    norm = jnp.sqrt(jnp.maximum(jnp.sum(jnp.square(column), axis=1), TINY))
    return column / norm[:, None]


def _noise(residual: Float[Array, "n k"], weight: Float[Array, "n k"], *, parameters: int) -> Float[Array, " n"]:
    """Standard deviation from weighted residuals: weights w that sum to one count as 1 / sum(w^2) neighbours."""
    free = 1.0 - parameters * jnp.sum(jnp.square(weight), axis=1)
    return jnp.sqrt(jnp.sum(weight * jnp.square(residual), axis=1) / jnp.maximum(free, 0.2))


def _covariance(centred: Float[Array, "n k 3"], weight: Float[Array, "n k"]) -> Float[Array, "n 3 3"]:
    """Weighted second moments, for weights that sum to one."""
    x, y, z = centred[:, :, 0], centred[:, :, 1], centred[:, :, 2]
    xx, yy, zz = (jnp.sum(weight * a * a, axis=1) for a in (x, y, z))
    xy, yz, zx = (jnp.sum(weight * a * b, axis=1) for a, b in ((x, y), (y, z), (z, x)))
    rows = [jnp.stack([xx, xy, zx], axis=1), jnp.stack([xy, yy, yz], axis=1), jnp.stack([zx, yz, zz], axis=1)]
    return jnp.stack(rows, axis=1)


def _tangents(normal: Float[Array, "n 3"]) -> tuple[Array, Array]:
    """Two unit vectors across each unit normal, after Duff et al. (2017); it has no branch near the poles."""
    x, y, z = normal[:, 0], normal[:, 1], normal[:, 2]
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return first, jnp.stack([b, sign + y * y * a, -y], axis=1)


def _least_squares(terms: tuple[Array, ...], values: Array, weight: Array) -> list[Array]:
    """Coefficients `[n]` of each term by the normal equations, solved by an unrolled Cholesky factorisation."""
    m = len(terms)
    lower = [[jnp.zeros_like(weight[:, 0])] * m for _ in range(m)]
    right = [jnp.sum(weight * t * values, axis=1) for t in terms]
    for i in range(m):
        for j in range(i + 1):
            entry = jnp.sum(weight * terms[i] * terms[j], axis=1) + (RIDGE if i == j else 0.0)
            entry = entry - sum(lower[i][p] * lower[j][p] for p in range(j))
            lower[i][j] = jnp.sqrt(jnp.maximum(entry, RIDGE * RIDGE)) if i == j else entry / lower[j][j]
    for i in range(m):
        right[i] = (right[i] - sum(lower[i][p] * right[p] for p in range(i))) / lower[i][i]
    for i in reversed(range(m)):
        right[i] = (right[i] - sum(lower[p][i] * right[p] for p in range(i + 1, m))) / lower[i][i]
    return right
