"""One step of iterative closest points, under jit: normal equations, unseen directions, robust weights.

Points are held as `[3, n]` here, coordinate by coordinate: sums over all points are then products of short, wide matrices,
which is what processors do fastest.
"""

from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cablejax.geometry.robust import MAD_STD
from cablejax.ops.neighbors.kth import kth_smallest
from cablejax.ops.rigid import se3_exp, skew

Method = Literal["point", "plane", "gicp"]
Kernel = Literal["none", "huber", "tukey", "cauchy"]
METHODS = get_args(Method)
KERNELS = get_args(Kernel)
FLATNESS = 1e-3  # variance along the normal over that across it, of generalised ICP (Segal et al. 2009)
_PRECISION = jax.lax.Precision.HIGHEST


class Pairs(NamedTuple):
    """Source points where they are now, with the points they correspond to; columns without one have weight 0.

    Attributes:
        source, source_normal: Points and unit normals `[3, n]`, moved into the target's frame.
        target, target_normal: Corresponding points `[3, n]`.
        weight: 1 for a pair, 0 for none `[n]`.
    """

    source: Float[Array, "3 n"]
    source_normal: Float[Array, "3 n"]
    target: Float[Array, "3 n"]
    target_normal: Float[Array, "3 n"]
    weight: Float[Array, " n"]


class Step(NamedTuple):
    """The motion after a step, how far it moved the points (root mean square), and the equations it solved."""

    T_target_source: Float[Array, "4 4"]
    moved: Float[Array, ""]
    rmse: Float[Array, ""]
    inliers: Float[Array, ""]
    covariance: Float[Array, "6 6"]
    observability: Float[Array, "6"]
    directions: Float[Array, "6 6"]
    seen: Bool[Array, "6"]
    center: Float[Array, "3"]


class _Term(NamedTuple):
    """Part of the residual's square: `weight (direction . difference)^2` for every pair."""

    direction: Float[Array, "3 n"]
    weight: Float[Array, " n"]


def _terms(pairs: Pairs, method: Method) -> tuple[float, tuple[_Term, ...]]:
    """What a pair's difference d costs: a share of |d|^2, and squares of its components along some directions.

    Generalised ICP takes both points for flat patches of covariance 1 across and `FLATNESS` along their normals n and m:
    d' C^-1 d with C = 2 I - c (n n' + m m'), c = 1 - FLATNESS. By Woodbury's identity C^-1 = I / 2 + a s s' + b e e'
    with s = n + m, e = n - m, a = c / 8 / (1 - c (1 + n.m) / 2) and b likewise with 1 - n.m. Scaled so that the normal
    counts about 1.
    """
    if method == "point":
        return 1.0, ()
    if method == "plane":
        return 0.0, (_Term(pairs.target_normal, jnp.ones_like(pairs.weight)),)
    c = 1 - FLATNESS
    cosine = jnp.sum(pairs.target_normal * pairs.source_normal, axis=0)
    total, apart = pairs.target_normal + pairs.source_normal, pairs.target_normal - pairs.source_normal
    scale = 2 * FLATNESS * c / 8
    a, b = scale / (1 - c * (1 + cosine) / 2), scale / (1 - c * (1 - cosine) / 2)
    return FLATNESS, (_Term(total, a), _Term(apart, b))


def _median(sq: Float[Array, " n"], valid: Bool[Array, " n"]) -> Float[Array, ""]:
    """The (lower) median of numbers that are not negative."""
    bits = jax.lax.bitcast_convert_type(jnp.where(valid, sq, jnp.inf), jnp.int32)  # in the order of the numbers
    middle = (jnp.sum(valid, dtype=jnp.int32) - 1) // 2
    return jax.lax.bitcast_convert_type(kth_smallest(bits, middle), jnp.float32)


def robust_weight(sq: Float[Array, " n"], valid: Bool[Array, " n"], kernel: Kernel) -> Float[Array, " n"]:
    """Weights of iteratively reweighted least squares, with the scale from the median of the residuals themselves."""
    if kernel == "none":
        return jnp.ones_like(sq)
    scale_sq = MAD_STD**2 * jnp.maximum(_median(sq, valid), 1e-20)
    ratio = sq / scale_sq
    if kernel == "huber":  # 1.345 sigma
        return jnp.where(ratio < 1.345**2, 1.0, 1.345 / jnp.sqrt(jnp.maximum(ratio, 1.0)))
    if kernel == "cauchy":  # 2.385 sigma
        return 1 / (1 + ratio / 2.385**2)
    return jnp.where(ratio < 4.685**2, jnp.square(1 - jnp.minimum(ratio / 4.685**2, 1.0)), 0.0)


def cross(a: Float[Array, "3 n"], b: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
    """Cross products, column by column."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _gram(rows: Float[Array, "r n"], weight: Float[Array, " n"]) -> Float[Array, "r r"]:
    return jnp.einsum("in,jn->ij", rows * weight[None], rows, precision=_PRECISION)


def _along(direction: Array, offset: Array, difference: Array, weight: Array) -> tuple[Array, Array]:
    """Sums `[6, 6]` and `[6]` of the squares of the components along a direction: a point's twist moves it there by
    (direction, offset x direction) . twist."""
    rows = jnp.concatenate(
        [direction, cross(offset, direction), jnp.sum(direction * difference, axis=0, keepdims=True)]
    )
    total = _gram(rows, weight)
    return total[:6, :6], total[:6, 6]


def _every_way(offset: Array, difference: Array, weight: Array) -> tuple[Array, Array]:
    """The same sums over all three axes, from the moments of the offsets."""
    total = _gram(jnp.concatenate([offset, difference, jnp.ones_like(weight)[None]]), weight)
    square, mixed, first = total[:3, :3], total[:3, 3:6], total[:3, 6]
    eye = jnp.eye(3)
    turn = jnp.trace(square) * eye - square
    matrix = jnp.block([[total[6, 6] * eye, -skew(first)], [skew(first), turn]])
    torque = jnp.stack([mixed[1, 2] - mixed[2, 1], mixed[2, 0] - mixed[0, 2], mixed[0, 1] - mixed[1, 0]])
    return matrix, jnp.concatenate([total[3:6, 6], torque])


def _directions(seen_matrix: Array, motion_matrix: Array) -> tuple[Array, Array]:
    """Eigenvectors of `seen v = share motion v`: six motions, each of unit displacement, and their visible share."""
    values, vectors = jnp.linalg.eigh(motion_matrix)
    # A single point or a line leaves motions that move nothing: they count as unseen, with a bounded twist.
    root = jnp.where(values > 1e-6 * values[-1], jax.lax.rsqrt(jnp.maximum(values, 1e-12 * values[-1] + 1e-30)), 0.0)
    whiten = vectors * root[None, :]
    shares, basis = jnp.linalg.eigh(_product(whiten.T, seen_matrix, whiten))
    return shares, _product(whiten, basis)


def _product(*factors: Array) -> Array:
    out = factors[-1]
    for factor in factors[-2::-1]:
        out = jnp.matmul(factor, out, precision=_PRECISION)
    return out


def _stiffness(terms, every: float, motion, pull, offset, difference, weight) -> tuple[Array, Array]:
    """Matrix `[6, 6]` and right-hand side `[6]` of the normal equations."""
    matrix, right = every * motion, every * pull
    for term in terms:
        more, push = _along(term.direction, offset, difference, weight * term.weight)
        matrix, right = matrix + more, right + push
    return matrix, right


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
        pairs: Points with their correspondences, in the target's frame.
        T_target_source: The motion that brought the source there.
        least_share: Share of the squared displacement along the normals below which a direction counts as unseen.
        method: "point", "plane" or "gicp". Static.
        kernel: Robust kernel. Static.
    """
    paired = pairs.weight > 0
    count = jnp.maximum(pairs.weight.sum(), 1.0)
    center = jnp.sum(pairs.weight[None] * pairs.target, axis=1) / count
    difference = jnp.where(paired[None], pairs.target - pairs.source, 0.0)
    offset = jnp.where(paired[None], pairs.source - center[:, None], 0.0)
    every, terms = _terms(pairs, method)
    distance = jnp.sum(difference**2, axis=0)
    residual = every * distance
    for term in terms:
        residual = residual + term.weight * jnp.sum(term.direction * difference, axis=0) ** 2
    weight = pairs.weight * robust_weight(residual, paired, kernel)
    motion, pull = _every_way(offset, difference, weight)
    normals, _ = _along(pairs.target_normal, offset, difference, weight)
    shares, directions = _directions(normals / count, motion / count)
    seen = shares > least_share
    matrix, right = _stiffness(terms, every, motion, pull, offset, difference, weight)
    basis = directions * seen[None, :]
    reduced = _product(basis.T, matrix / count, basis)
    inverse = jnp.linalg.inv(reduced + jnp.diag(1.0 - seen)) * (seen[:, None] & seen[None, :])
    inverse = _product(basis, inverse, basis.T)
    twist = _product(inverse, right / count)
    moved = jnp.sqrt(jnp.maximum(_product(twist, motion / count, twist), 0.0))
    variance = jnp.sum(weight * residual) / jnp.maximum(count - 6, 1.0)
    rmse = jnp.sqrt(jnp.sum(pairs.weight * distance) / count)
    new = _product(_about(twist, center), T_target_source)
    return Step(
        T_target_source=new,
        moved=moved,
        rmse=rmse,
        inliers=pairs.weight.sum(),
        covariance=variance * inverse / count,
        observability=shares,
        directions=directions,
        seen=seen,
        center=center,
    )


def _about(twist: Float[Array, "6"], center: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """The motion of a twist whose rotation is about `center`."""
    out = se3_exp(twist)
    return out.at[:3, 3].add(center - _product(out[:3, :3], center))
