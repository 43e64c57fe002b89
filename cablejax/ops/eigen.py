"""Eigenvalues and eigenvectors of many symmetric 3 by 3 matrices in closed form, without LAPACK's loop."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class SymmetricEigen(NamedTuple):
    """Eigenvalues, the smallest first, and unit eigenvectors that form a right-handed frame.

    Attributes:
        values: `[..., 3]`.
        vectors: `[..., 3, 3]`, a row each, in the order of the values.
    """

    values: Float[Array, "*b 3"]
    vectors: Float[Array, "*b 3 3"]


def symmetric_eigen(matrices: Float[Array, "*b 3 3"]) -> SymmetricEigen:
    """Eigenvalues and eigenvectors of symmetric matrices.

    The root of the cubic that lies farthest from the other two (Smith 1961) has a well-determined eigenvector, the longest
    cross product of two rows of A - root I. What is left is a symmetric 2 by 2 matrix in the plane across it, which is
    solved by its angle (Eberly 2014, "A robust eigensolver for 3x3 symmetric matrices"). So vectors are unit and across each
    other to rounding also where eigenvalues are equal, and values are right to some 1e-6 of the largest in float32.
    Derivatives are those of eigenvalues and eigenvectors; of vectors whose eigenvalues are equal they are taken as zero.

    Args:
        matrices: Symmetric `[..., 3, 3]`; the upper triangle is read.

    Returns:
        Values and vectors.

    Example:
        >>> values, vectors = symmetric_eigen(jnp.diag(jnp.array([3.0, 1.0, 2.0])))
        >>> values.tolist(), jnp.abs(vectors[0]).tolist()
        ([1.0, 2.0, 3.0], [0.0, 1.0, 0.0])
    """
    return SymmetricEigen(*_eigen(matrices))


@jax.custom_jvp
def _eigen(matrices: Float[Array, "*b 3 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3 3"]]:
    scale = jnp.max(jnp.abs(matrices), axis=(-2, -1))
    unit = matrices / jnp.where(scale > 0, scale, 1.0)[..., None, None]
    a, b, c = unit[..., 0, 0], unit[..., 1, 1], unit[..., 2, 2]
    d, e, f = unit[..., 0, 1], unit[..., 0, 2], unit[..., 1, 2]
    mean = (a + b + c) / 3
    a, b, c = a - mean, b - mean, c - mean
    size = jnp.sqrt((a * a + b * b + c * c + 2 * (d * d + e * e + f * f)) / 6)
    safe = jnp.where(size > 0, size, 1.0)
    a, b, c, d, e, f = (entry / safe for entry in (a, b, c, d, e, f))
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    angle = jnp.arccos(jnp.clip(half, -1.0, 1.0)) / 3
    # The largest where the other two are nearer to each other than to it, the smallest if not.
    root = 2 * jnp.where(half >= 0, jnp.cos(angle), jnp.cos(angle + 2 * jnp.pi / 3))
    x, y, z = a - root, b - root, c - root
    products = jnp.stack(
        [
            jnp.stack([d * f - e * y, e * d - x * f, x * y - d * d], axis=-1),
            jnp.stack([d * z - e * f, e * e - x * z, x * f - d * e], axis=-1),
            jnp.stack([y * z - f * f, f * e - d * z, d * f - y * e], axis=-1),
        ],
        axis=-2,
    )
    square = jnp.square(products).sum(axis=-1)
    longest = jnp.max(square, axis=-1, keepdims=True)
    first = jnp.take_along_axis(products, jnp.argmax(square, axis=-1)[..., None, None], axis=-2)[..., 0, :]
    axis = jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0], dtype=first.dtype), first.shape)
    sure = longest > 0  # not of a multiple of the identity, for which every direction will do
    first = jnp.where(sure, first / jnp.sqrt(jnp.where(sure, longest, 1.0)), axis)
    u, w = _across(first)
    rest = jnp.stack([jnp.stack([a, d, e], -1), jnp.stack([d, b, f], -1), jnp.stack([e, f, c], -1)], axis=-2)
    along_first, along_u, along_w = ((rest * each[..., None, :]).sum(axis=-1) for each in (first, u, w))
    uu, uw, ww = (along_u * u).sum(axis=-1), (along_u * w).sum(axis=-1), (along_w * w).sum(axis=-1)
    middle, radius = 0.5 * (uu + ww), jnp.hypot(0.5 * (uu - ww), uw)
    turn = 0.5 * jnp.arctan2(uw, 0.5 * (uu - ww))
    cos, sin = jnp.cos(turn)[..., None], jnp.sin(turn)[..., None]
    high, low = cos * u + sin * w, cos * w - sin * u
    alone = (along_first * first).sum(axis=-1)
    largest = (half >= 0)[..., None]
    values = jnp.where(
        largest,
        jnp.stack([middle - radius, middle + radius, alone], axis=-1),
        jnp.stack([alone, middle - radius, middle + radius], axis=-1),
    )
    # u, w and the first are right-handed, so -low, high and the first are.
    vectors = jnp.where(
        largest[..., None], jnp.stack([-low, high, first], axis=-2), jnp.stack([first, -low, high], axis=-2)
    )
    # Rounding may put two that are equal the wrong way round.
    values = jnp.stack(
        [values[..., 0], jnp.maximum(values[..., 1], values[..., 0]), jnp.maximum(values[..., 2], values[..., 1])],
        axis=-1,
    )
    return (values * size[..., None] + mean[..., None]) * scale[..., None], vectors


def _across(unit: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Two unit vectors that form a right-handed frame with a third, given, as their last (Duff et al. 2017)."""
    x, y, z = unit[..., 0], unit[..., 1], unit[..., 2]
    sign = jnp.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    u = jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    return u, jnp.stack([b, sign + y * y * a, -y], axis=-1)


@_eigen.defjvp
def _eigen_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """d values = v dA v, and d v_i = sum over j of v_j (v_j dA v_i) / (value_i - value_j)."""
    values, vectors = _eigen(primals[0])
    change = jnp.einsum(
        "...ip,...pq,...jq->...ij", vectors, 0.5 * (tangents[0] + jnp.swapaxes(tangents[0], -1, -2)), vectors
    )
    apart = values[..., :, None] - values[..., None, :]
    equal = jnp.abs(apart) <= 1e-6 * jnp.max(jnp.abs(values), axis=-1)[..., None, None]
    mixed = jnp.where(equal, 0.0, change / jnp.where(equal, 1.0, apart))
    turned = jnp.einsum("...ij,...jp->...ip", mixed, vectors)
    return (values, vectors), (jnp.diagonal(change, axis1=-2, axis2=-1), turned)
