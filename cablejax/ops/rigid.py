"""Rigid motions: the group SE(3) as 4 x 4 matrices, its exponential and logarithm, and the best motion between pairs.

A motion is `T_target_source [4, 4]`, eq. (9) of Su et al. (2025): it takes source coordinates to target ones.
Everything works on one motion; batch with `vmap`. Products ask for full float32 precision, since accelerators that
round the factors first would lose a tenth of a millimetre on a metre.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_PRECISION = jax.lax.Precision.HIGHEST
_SMALL = 0.25  # squared angle below which the power series are used; their first term left out is below 1e-9


class _Series(NamedTuple):
    """The coefficients of the exponential at one angle: sin(a)/a, (1 - cos a)/a^2, (a - sin a)/a^3."""

    a: Array
    b: Array
    c: Array


def skew(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The matrix of the cross product: `skew(v) @ w == cross(v, w)`."""
    x, y, z = v
    zero = jnp.zeros_like(x)
    return jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])


def _series(sq: Array) -> _Series:
    small = sq < _SMALL
    safe = jnp.where(small, 1.0, sq)  # double where: the branch not taken must not divide by zero in the gradient
    angle = jnp.sqrt(safe)
    a = jnp.where(small, 1 - sq / 6 * (1 - sq / 20 * (1 - sq / 42)), jnp.sin(angle) / angle)
    # 2 sin^2(a/2) rather than 1 - cos a, which cancels
    b = jnp.where(small, 0.5 * (1 - sq / 12 * (1 - sq / 30 * (1 - sq / 56))), 2 * jnp.sin(angle / 2) ** 2 / safe)
    c = jnp.where(small, (1 - sq / 20 * (1 - sq / 42 * (1 - sq / 72))) / 6, (angle - jnp.sin(angle)) / (safe * angle))
    return _Series(a, b, c)


def compose(rotation: Float[Array, "3 3"], translation: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """Assemble `[R | t]`, eq. (9), into a 4 x 4 matrix."""
    top = jnp.concatenate([rotation, translation[:, None]], axis=1)
    return jnp.concatenate([top, jnp.asarray([[0.0, 0.0, 0.0, 1.0]], dtype=top.dtype)], axis=0)


def se3_exp(twist: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """The motion of a twist `(translation part, rotation vector)`, the exponential of SE(3).

    Args:
        twist: Translation part `[3]` in the unit of the cloud, then the rotation vector `[3]` in radians.

    Example:
        >>> se3_exp(jnp.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]))[:3, 3].tolist()
        [1.0, 2.0, 3.0]
    """
    rho, phi = twist[:3], twist[3:]
    series = _series(jnp.dot(phi, phi, precision=_PRECISION))
    cross = skew(phi)
    square = jnp.matmul(cross, cross, precision=_PRECISION)
    eye = jnp.eye(3, dtype=twist.dtype)
    rotation = eye + series.a * cross + series.b * square
    left = eye + series.b * cross + series.c * square
    return compose(rotation, jnp.matmul(left, rho, precision=_PRECISION))


def _quaternion(rotation: Array) -> Array:
    """Unit quaternion `(w, x, y, z)`, `w >= 0`: the longest of the four ways to write it, so none divides by zero."""
    r = rotation
    rows = jnp.stack(
        [
            jnp.stack([1 + r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]),
            jnp.stack([r[2, 1] - r[1, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]]),
            jnp.stack([r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1]]),
            jnp.stack([r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 - r[0, 0] - r[1, 1] + r[2, 2]]),
        ]
    )
    q = rows[jnp.argmax(jnp.diagonal(rows))]
    q = q / jnp.sqrt(jnp.dot(q, q, precision=_PRECISION))
    return jnp.where(q[0] < 0, -q, q)


def so3_log(rotation: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The rotation vector, in radians, of length pi at most; accurate up to half a turn."""
    q = _quaternion(rotation)
    w, v = q[0], q[1:]
    sq = jnp.dot(v, v, precision=_PRECISION)
    small = sq < 1e-6
    norm = jnp.sqrt(jnp.where(small, 1.0, sq))
    near_one = jnp.where(small, w, 1.0)
    scale = jnp.where(small, 2 / near_one - 2 * sq / (3 * near_one**3), 2 * jnp.arctan2(norm, w) / norm)
    return scale * v


def se3_log(T: Float[Array, "4 4"]) -> Float[Array, "6"]:
    """The twist of a motion, the inverse of `se3_exp` for rotations below half a turn.

    Example:
        >>> twist = jnp.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3])
        >>> bool(jnp.allclose(se3_log(se3_exp(twist)), twist, atol=1e-6))
        True
    """
    phi = so3_log(T[:3, :3])
    sq = jnp.dot(phi, phi, precision=_PRECISION)
    small = sq < _SMALL
    safe = jnp.where(small, 1.0, sq)
    half = jnp.sqrt(safe) / 2
    taylor = (1 + sq / 60 * (1 + sq / 42 * (1 + sq / 40))) / 12
    d = jnp.where(small, taylor, (1 - half * jnp.cos(half) / jnp.sin(half)) / safe)
    cross = skew(phi)
    inverse = jnp.eye(3, dtype=T.dtype) - cross / 2 + d * jnp.matmul(cross, cross, precision=_PRECISION)
    return jnp.concatenate([jnp.matmul(inverse, T[:3, 3], precision=_PRECISION), phi])


def invert(T: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """The inverse motion, by the transpose of its rotation."""
    rotation = T[:3, :3].T
    return compose(rotation, -jnp.matmul(rotation, T[:3, 3], precision=_PRECISION))


def transform(T_target_source: Float[Array, "4 4"], xyz: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Move points `[n, 3]` from the source frame to the target frame.

    Example:
        >>> transform(se3_exp(jnp.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])), jnp.zeros((1, 3))).tolist()
        [[0.0, 0.0, 1.0]]
    """
    moved = jnp.matmul(xyz, T_target_source[:3, :3].T, precision=_PRECISION)
    return moved + T_target_source[None, :3, 3]


def kabsch(
    source: Float[Array, "n 3"], target: Float[Array, "n 3"], *, weights: Float[Array, " n"] | None = None
) -> Float[Array, "4 4"]:
    """The rigid motion that best takes each source point to its target point, in the (weighted) least squares sense.

    Kabsch (1976): eq. (9) of Su et al. (2025) solved for known pairs. The result is a rotation even where a
    reflection would fit better (flat or mirrored sets). Where the pairs leave the rotation open (fewer than three, or
    all on a line), one of the equally good motions is returned.

    Args:
        source: Points `[n, 3]`.
        target: The corresponding points `[n, 3]`, in the same unit.
        weights: Weight of each pair `[n]`, none negative, not all zero; zero for padding. One each if None.

    Returns:
        `T_target_source [4, 4]`.

    Raises:
        ValueError: If the two sets differ in shape.

    Example:
        >>> source = jnp.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> kabsch(source, source + jnp.array([[1.0, 2, 3]]))[:3, 3].round(5).tolist()
        [1.0, 2.0, 3.0]
    """
    if source.shape != target.shape:
        raise ValueError(f"target: expected the shape of source, {list(source.shape)}, got {list(target.shape)}")
    w = jnp.ones(source.shape[0], source.dtype) if weights is None else weights
    w = w / jnp.sum(w)
    mean_source = jnp.sum(w[:, None] * source, axis=0)
    mean_target = jnp.sum(w[:, None] * target, axis=0)
    covariance = jnp.matmul(
        (w[:, None] * (target - mean_target[None, :])).T, source - mean_source[None, :], precision=_PRECISION
    )
    u, _, vt = jnp.linalg.svd(covariance)
    # Last singular direction flipped where the product would be a reflection.
    sign = jnp.where(jnp.linalg.det(u) * jnp.linalg.det(vt) < 0, -1.0, 1.0)
    rotation = jnp.matmul(
        u * jnp.stack([jnp.ones_like(sign), jnp.ones_like(sign), sign])[None, :], vt, precision=_PRECISION
    )
    return compose(rotation, mean_target - jnp.matmul(rotation, mean_source, precision=_PRECISION))
