"""One step of iterative closest points, under jit: normal equations, unseen directions, robust weights."""

from functools import partial
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cablejax.ops.rigid import se3_exp, transform

Method = Literal["point", "plane", "gicp"]
Kernel = Literal["none", "huber", "tukey", "cauchy"]
METHODS = get_args(Method)
KERNELS = get_args(Kernel)
FLATNESS = 1e-3  # variance along the normal over that across it, of generalised ICP (Segal et al. 2009)
_PRECISION = jax.lax.Precision.HIGHEST


class Pairs(NamedTuple):
    """Source points with their partners; rows without one have weight 0.

    Attributes:
        source, source_normal: Points and unit normals `[n, 3]` in the source frame.
        target, target_normal: Partners `[n, 3]`.
        weight: 1 for a pair, 0 for none `[n]`.
    """

    source: Float[Array, "n 3"]
    source_normal: Float[Array, "n 3"]
    target: Float[Array, "n 3"]
    target_normal: Float[Array, "n 3"]
    weight: Float[Array, " n"]


class Step(NamedTuple):
    """The motion after a step, how far it moved the points (root mean square), and the equations it solved."""

    T_target_source: Float[Array, "4 4"]
    moved: Float[Array, ""]
    rmse: Float[Array, ""]
    covariance: Float[Array, "6 6"]
    observability: Float[Array, "6"]
    directions: Float[Array, "6 6"]
    seen: Bool[Array, "6"]
    center: Float[Array, "3"]


def information(pairs: Pairs, rotation: Float[Array, "3 3"], method: Method) -> Float[Array, "n 3 3"]:
    """How much each component of a pair's difference counts: all alike, along the normal, or as two flat patches do."""
    eye = jnp.eye(3)[None]
    if method == "point":
        return jnp.broadcast_to(eye, (pairs.source.shape[0], 3, 3))
    outer_target = pairs.target_normal[:, :, None] * pairs.target_normal[:, None, :]
    if method == "plane":
        return outer_target
    turned = jnp.matmul(pairs.source_normal, rotation.T, precision=_PRECISION)
    outer_source = turned[:, :, None] * turned[:, None, :]
    # Each patch has covariance 1 across and FLATNESS along its normal; scaled so that the normal counts about 1.
    covariance = 2 * eye - (1 - FLATNESS) * (outer_target + outer_source)
    return 2 * FLATNESS * jnp.linalg.inv(covariance)


def robust_weight(sq: Float[Array, " n"], valid: Bool[Array, " n"], kernel: Kernel) -> Float[Array, " n"]:
    """Weights of iteratively reweighted least squares, with the scale from the median of the residuals themselves."""
    if kernel == "none":
        return jnp.ones_like(sq)
    middle = jnp.nanmedian(jnp.where(valid, sq, jnp.nan))
    scale_sq = 1.4826**2 * jnp.maximum(jnp.nan_to_num(middle), 1e-20)
    ratio = sq / scale_sq
    if kernel == "huber":  # 1.345 sigma
        return jnp.where(ratio < 1.345**2, 1.0, 1.345 / jnp.sqrt(jnp.maximum(ratio, 1.0)))
    if kernel == "cauchy":  # 2.385 sigma
        return 1 / (1 + ratio / 2.385**2)
    return jnp.where(ratio < 4.685**2, jnp.square(1 - jnp.minimum(ratio / 4.685**2, 1.0)), 0.0)


def _jacobian(offset: Array) -> Array:
    """Displacement of points at `offset` from the centre under a twist: `[n, 3, 6]` = [I, -[x]]."""
    x, y, z = offset[:, 0], offset[:, 1], offset[:, 2]
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([zero, z, -y], 1), jnp.stack([-z, zero, x], 1), jnp.stack([y, -x, zero], 1)], 1)
    return jnp.concatenate([jnp.broadcast_to(jnp.eye(3)[None], cross.shape), cross], axis=2)


def _directions(seen_matrix: Array, motion_matrix: Array) -> tuple[Array, Array]:
    """Eigenvectors of `seen v = share motion v`: six motions, each of unit displacement, and their visible share."""
    values, vectors = jnp.linalg.eigh(motion_matrix)
    # A single point or a line leaves motions that move nothing: they count as unseen, with a bounded twist.
    root = jnp.where(values > 1e-6 * values[-1], jax.lax.rsqrt(jnp.maximum(values, 1e-12 * values[-1] + 1e-30)), 0.0)
    whiten = vectors * root[None, :]
    shares, basis = jnp.linalg.eigh(
        jnp.matmul(whiten.T, jnp.matmul(seen_matrix, whiten, precision=_PRECISION), precision=_PRECISION)
    )
    return shares, jnp.matmul(whiten, basis, precision=_PRECISION)


def _sum(jacobian: Array, matrix: Array, weight: Array) -> Array:
    return jnp.einsum("nai,nab,nbj,n->ij", jacobian, matrix, jacobian, weight, precision=_PRECISION, optimize="optimal")


@partial(jax.jit, static_argnames=("method", "kernel"))
def icp_step(
    pairs: Pairs,
    T_target_source: Float[Array, "4 4"],
    least_share: Float[Array, ""],
    *,
    method: Method,
    kernel: Kernel,
) -> Step:
    """One Gauss-Newton step on the pairs, along the directions of motion that the surface shows.

    The displacement of the points under a small motion has a part along their normals, which the surface resists, and a
    part across, along which it slides. Directions of which less than `least_share` is along the normals are left alone:
    a cylinder is neither turned about nor pushed along its axis. Point-to-point pairs would do so, since samples lock
    onto samples.

    Args:
        pairs: Points with partners, in both frames.
        T_target_source: Where the source is now.
        least_share: Share of the squared displacement along the normals below which a direction counts as unseen.
        method: "point", "plane" or "gicp". Static.
        kernel: Robust kernel. Static.
    """
    weight = pairs.weight
    count = jnp.maximum(weight.sum(), 1.0)
    moved = transform(T_target_source, pairs.source)
    center = jnp.sum(weight[:, None] * pairs.target, axis=0) / count
    difference = jnp.where(weight[:, None] > 0, pairs.target - moved, 0.0)
    jacobian = _jacobian(jnp.where(weight[:, None] > 0, moved - center[None, :], 0.0))
    matrix = information(pairs, T_target_source[:3, :3], method)
    residual = jnp.einsum("ni,nij,nj->n", difference, matrix, difference)
    weight = weight * robust_weight(residual, weight > 0, kernel)
    normal_outer = pairs.target_normal[:, :, None] * pairs.target_normal[:, None, :]
    eye = jnp.broadcast_to(jnp.eye(3)[None], normal_outer.shape)
    motion = _sum(jacobian, eye, weight) / count
    shares, directions = _directions(_sum(jacobian, normal_outer, weight) / count, motion)
    seen = shares > least_share
    gradient = jnp.einsum("nai,nab,nb,n->i", jacobian, matrix, difference, weight, precision=_PRECISION) / count
    normal = _sum(jacobian, matrix, weight) / count
    basis = directions * seen[None, :]
    reduced = jnp.matmul(basis.T, jnp.matmul(normal, basis, precision=_PRECISION), precision=_PRECISION)
    inverse = jnp.linalg.inv(reduced + jnp.diag(1.0 - seen)) * (seen[:, None] & seen[None, :])
    inverse = jnp.matmul(basis, jnp.matmul(inverse, basis.T, precision=_PRECISION), precision=_PRECISION)
    twist = jnp.matmul(inverse, gradient, precision=_PRECISION)
    size = jnp.sqrt(
        jnp.maximum(jnp.dot(twist, jnp.matmul(motion, twist, precision=_PRECISION), precision=_PRECISION), 0.0)
    )
    variance = jnp.sum(weight * residual) / jnp.maximum(count - 6, 1.0)
    rmse = jnp.sqrt(jnp.sum(pairs.weight * jnp.sum(difference**2, axis=1)) / count)
    about = se3_exp(twist)
    about = about.at[:3, 3].add(center - jnp.matmul(about[:3, :3], center, precision=_PRECISION))
    new = jnp.matmul(about, T_target_source, precision=_PRECISION)
    return Step(new, size, rmse, variance * inverse / count, shares, directions, seen, center)
