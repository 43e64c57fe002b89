"""The adaptive filter of equations (2)-(8), and variants on the same weights that do not shrink a cable."""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cablejax.ops.moments import local_moments
from cablejax.ops.neighbors import knn
from cablejax.types import PointCloud


class FilterResult(NamedTuple):
    """A filtered cloud.

    Attributes:
        xyz: Filtered points `[n, 3]`; rows of padding and points that are not finite come back unchanged.
        width: Kernel width of each point `[n]`, sigma_f of eq. (4), in the cloud's unit; 0 where nothing was filtered.
        status: `Status` bits `[n]` int32: TOO_FEW_NEIGHBORS, NOT_FINITE.
    """

    xyz: Float[Array, "n 3"]
    width: Float[Array, " n"]
    status: Int[Array, " n"]


@partial(jax.jit, static_argnames=("k", "order", "form", "iterations"))
def adaptive_filter(
    cloud: PointCloud,
    *,
    k: int = 40,
    alpha: float | Float[Array, ""] | None = None,
    beta: float | Float[Array, ""] | None = None,
    gamma: float | Float[Array, ""] = 0.0,
    tau: float | Float[Array, ""] | None = None,
    order: int = 0,
    form: Literal["linear", "exponential"] = "linear",
    iterations: int = 1,
) -> FilterResult:
    """Smooth each point with a Gaussian as wide as its local noise.

    Equations (2)-(8) of Su et al. (2025). Equation (5) prints the width as sigma_i; it is read as sigma_f of eq. (4).
    A neighbourhood is the point and its k nearest; eq. (6) leaves the point itself out, where it would be 0/0.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        k: Neighbours per point, the point itself not counted. Static.
        alpha: Kernel width per unit of local noise, eq. (5); 1 if None.
        beta: Least kernel width, in the cloud's unit, eq. (5); if None, 0 (linear) or the median local noise.
        gamma: Extra weight per unit of gradient above `tau`, eq. (7).
        tau: Gradient norm above which a point counts as an edge, eq. (7); the cloud's 95th percentile if None.
        order: Degree of the local surface: 0 the paper's mean, 1 a plane, 2 a quadric. Static.
        form: "linear" is eq. (5), "exponential" is beta * exp(alpha * sigma_i / beta). Static.
        iterations: How often the filter is applied, each time to the last result. Static.

    Returns:
        Filtered points `[n, 3]`, widths `[n]` in the cloud's unit, and a status per point.

    Raises:
        ValueError: If `k` or `iterations` is below 1, `order` is not 0, 1 or 2, or `form` is neither word.
    """
    if k < 1:
        raise ValueError(f"k: expected at least 1, got {k}")
    if order not in (0, 1, 2):
        raise ValueError(f"order: expected 0, 1 or 2, got {order}")
    if form not in ("linear", "exponential"):
        raise ValueError(f'form: expected "linear" or "exponential", got {form!r}')
    if iterations < 1:
        raise ValueError(f"iterations: expected at least 1, got {iterations}")
    settings = (alpha, beta, gamma, tau)
    result = _pass(cloud, settings, k=k, order=order, form=form)
    for _ in range(iterations - 1):
        again = _pass(PointCloud(result.xyz, cloud.mask), settings, k=k, order=order, form=form)
        result = FilterResult(again.xyz, again.width, again.status | result.status)
    return result


def _pass(cloud: PointCloud, settings: tuple, *, k: int, order: int, form: str) -> FilterResult:
    """One application of the filter."""
    alpha, beta, gamma, tau = settings
    found = knn(cloud.xyz, k=k, mask=cloud.mask)
    valid = cloud.mask & jnp.isfinite(cloud.xyz).all(axis=1)
    n = cloud.xyz.shape[0]
    own = jnp.where(valid, jnp.arange(n), -1)[:, None]
    neighbors = jnp.concatenate([own, found.neighbors], axis=1)
    sq_dist = jnp.concatenate([jnp.where(valid, 0.0, jnp.inf)[:, None], found.sq_dist], axis=1)
    clean = jnp.where(valid[:, None], cloud.xyz, 0.0)
    offsets = jnp.where((neighbors >= 0)[..., None], clean[jnp.maximum(neighbors, 0)] - clean[:, None, :], 0.0)

    noise = jnp.sqrt(local_moments(clean, neighbors).variance)
    width = _width(noise, valid, alpha, beta, form)
    edge = _edge_weight(offsets, sq_dist, valid, gamma, tau)
    safe = jnp.where(width > 0, width, 1.0)
    near = jnp.isfinite(sq_dist)
    exponent = -jnp.where(near, sq_dist, 0.0) / (2.0 * jnp.square(safe))[:, None]
    weight = jnp.where(near, edge[jnp.maximum(neighbors, 0)] * jnp.exp(exponent), 0.0)
    move = _fit(offsets, weight, order)
    moved = valid & (width > 0)
    xyz = jnp.where(moved[:, None], cloud.xyz + move, cloud.xyz)
    return FilterResult(xyz, jnp.where(moved, width, 0.0), found.status)


def _width(noise: Array, valid: Array, alpha, beta, form: str) -> Array:
    """Kernel widths `[n]`, eqs. (4) and (5)."""
    alpha = 1.0 if alpha is None else alpha
    if form == "linear":
        return alpha * noise + (0.0 if beta is None else beta)
    beta = jnp.nanmedian(jnp.where(valid, noise, jnp.nan)) if beta is None else jnp.asarray(beta, dtype=noise.dtype)
    safe = jnp.where(beta > 0, beta, 1.0)
    return jnp.where(beta > 0, beta * jnp.exp(alpha * noise / safe), 0.0)


def _edge_weight(offsets: Array, sq_dist: Array, valid: Array, gamma, tau) -> Array:
    """Weight of each point `[n]`, eqs. (6) and (7)."""
    apart = jnp.isfinite(sq_dist) & (sq_dist > 0)
    length = jnp.sqrt(jnp.where(apart, sq_dist, 1.0))
    gradient = jnp.where(apart[..., None], -offsets / length[..., None], 0.0).sum(axis=1)
    norm = jnp.sqrt(jnp.maximum(jnp.square(gradient).sum(axis=1), jnp.finfo(gradient.dtype).tiny))
    tau = jnp.nanquantile(jnp.where(valid, norm, jnp.nan), 0.95) if tau is None else tau
    return 1.0 + gamma * jnp.maximum(0.0, norm - tau)


def _fit(offsets: Array, weight: Array, order: int) -> Array:
    """Where each point moves `[n, 3]`: to the weighted mean, or along the normal onto the weighted plane or quadric."""
    total = jnp.maximum(weight.sum(axis=1), jnp.finfo(weight.dtype).tiny)
    mean = (weight[..., None] * offsets).sum(axis=1) / total[:, None]
    if order == 0:
        return mean
    centred = offsets - mean[:, None, :]
    covariance = jnp.einsum("nk,nki,nkj->nij", weight, centred, centred) / total[:, None, None]
    axes = jnp.linalg.eigh(covariance)[1]
    normal = axes[:, :, 0]
    if order == 1:
        return jnp.einsum("ni,ni->n", mean, normal)[:, None] * normal
    local = jnp.einsum("nki,nij->nkj", offsets, axes[:, :, ::-1])
    size = jnp.sqrt(jnp.maximum(jnp.trace(covariance, axis1=1, axis2=2), jnp.finfo(weight.dtype).tiny))
    u, v, h = jnp.moveaxis(local / size[:, None, None], -1, 0)
    terms = jnp.stack([jnp.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    normal_matrix = jnp.einsum("nk,nki,nkj->nij", weight, terms, terms) / total[:, None, None]
    right = jnp.einsum("nk,nki,nk->ni", weight, terms, h) / total[:, None]
    # A ridge far below the terms' own size keeps collinear neighbourhoods solvable.
    ridge = 1e-6 * jnp.eye(6, dtype=weight.dtype)
    height = jnp.linalg.solve(normal_matrix + ridge, right[..., None])[:, 0, 0]
    return (height * size)[:, None] * normal
