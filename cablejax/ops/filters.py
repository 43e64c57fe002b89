"""The adaptive filter of equations (2)-(8), and variants on the same weights that do not shrink a cable."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cablejax.ops.moments import masked_variance
from cablejax.ops.neighbors import knn
from cablejax.ops.surface_fit import SurfaceFit, fit_surface
from cablejax.types import PointCloud

PILOT = 2048  # points whose fits estimate the width


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


class _Settings(NamedTuple):
    """The numbers of equations (5) and (7), None where they are to be estimated."""

    alpha: float | Float[Array, ""] | None
    beta: float | Float[Array, ""] | None
    gamma: float | Float[Array, ""]
    tau: float | Float[Array, ""] | None
    crowding: float | Float[Array, ""]


@partial(jax.jit, static_argnames=("k", "order", "form", "iterations"))
def adaptive_filter(
    cloud: PointCloud,
    *,
    k: int = 80,
    alpha: float | Float[Array, ""] | None = None,
    beta: float | Float[Array, ""] | None = None,
    gamma: float | Float[Array, ""] = 0.0,
    tau: float | Float[Array, ""] | None = None,
    order: int = 0,
    form: str = "linear",
    iterations: int = 1,
    crowding: float | Float[Array, ""] = 1.0,
) -> FilterResult:
    """Smooth each point with a Gaussian as wide as its local noise.

    Equations (2)-(8) of Su et al. (2025). Equation (5) prints the width as sigma_i; it is read as sigma_f of eq. (4).
    A neighbourhood is the point and its k nearest; eq. (6) leaves the point itself out, where it would be 0/0.

    The weighted mean of eq. (8) lies inside a curved surface: a cable comes out too thin. `order` 1 and 2 move each point
    along its normal onto a plane or quadric fitted with the same weights.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        k: Neighbours per point, the point itself not counted; an upper bound on how many get weight. Static.
        alpha: Kernel width per unit of local noise, eq. (5). If None, 1 for order 0; otherwise the largest up to 1 at
            which what the surface leaves out stays below a quarter of the noise, from the median noise and curvature of
            fits at 2,048 of the points: wide on noisy clouds, narrow on clean or strongly curved ones.
        beta: Least kernel width, in the cloud's unit, eq. (5); if None, 0 (linear) or the median local noise.
        gamma: Extra weight per unit of gradient above `tau`, eq. (7).
        tau: Gradient norm above which a point counts as an edge, eq. (7); the cloud's 95th percentile if None.
        order: Degree of the local surface: 0 the paper's mean, 1 a plane, 2 a quadric. Static.
        form: "linear" is eq. (5), "exponential" is beta * exp(alpha * sigma_i / beta). Static.
        iterations: How often the filter is applied, each time to the last result. Static.
        crowding: With order 2, how far noise moves points along the normal: 1 if that is all it does, 1/2 for equal noise
            in all directions, 0 for noise along parallel beams. Inside a curved surface such points crowd, and their mean
            lies noise^2 times the sum of the curvatures too deep, which is put back. Nothing is put back at 0.

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
    settings = _Settings(alpha, beta, gamma, tau, crowding)
    result = _once(cloud, settings, k=k, order=order, form=form)
    for _ in range(iterations - 1):
        again = _once(PointCloud(result.xyz, cloud.mask), settings, k=k, order=order, form=form)
        result = FilterResult(again.xyz, again.width, again.status | result.status)
    return result


def _once(cloud: PointCloud, settings: _Settings, *, k: int, order: int, form: str) -> FilterResult:
    """One application of the filter."""
    found = knn(cloud.xyz, k=k, mask=cloud.mask)
    valid = cloud.mask & jnp.isfinite(cloud.xyz).all(axis=1)
    own = jnp.where(valid, jnp.arange(cloud.xyz.shape[0]), -1)[:, None]
    neighbors = jnp.concatenate([own, found.neighbors], axis=1)
    sq_dist = jnp.concatenate([jnp.where(valid, 0.0, jnp.inf)[:, None], found.sq_dist], axis=1)
    clean = jnp.where(valid[:, None], cloud.xyz, 0.0)
    at = jnp.maximum(neighbors, 0)
    offsets = jnp.where((neighbors >= 0)[:, :, None], clean[at] - clean[:, None, :], 0.0)

    noise = jnp.sqrt(masked_variance(offsets, neighbors >= 0))
    plain = isinstance(settings.gamma, int | float) and settings.gamma == 0
    edge = 1.0 if plain else _edge_weight(offsets, sq_dist, valid, settings)[at]
    alpha = settings.alpha
    if alpha is None:
        alpha = 1.0 if order == 0 else _estimate_alpha(offsets, sq_dist, noise, valid, order)
    width = _width(noise, valid, alpha, settings.beta, form)
    weight = edge * _kernel(sq_dist, width)
    if order == 0:
        total = jnp.maximum(weight.sum(axis=1), jnp.finfo(weight.dtype).tiny)
        move = (weight[:, :, None] * offsets).sum(axis=1) / total[:, None]
    else:
        move = _onto(fit_surface(offsets, weight, order=order), neighbors, settings.crowding)
    moved = valid & (width > 0)
    xyz = jnp.where(moved[:, None], cloud.xyz + move, cloud.xyz)
    return FilterResult(xyz, jnp.where(moved, width, 0.0), found.status)


def _onto(fit: SurfaceFit, neighbors: Int[Array, "n k"], crowding) -> Float[Array, "n 3"]:
    """From each point onto its surface, raised by what points crowding on the inside have pulled it down.

    One fit's curvature is far noisier than its height, so the mean over the neighbours is put back, as a vector: their
    normals have either sign.
    """
    depth = (jnp.square(fit.noise) * fit.bend)[:, None] * fit.normal
    near = (neighbors >= 0)[:, :, None]
    count = jnp.maximum(near.sum(axis=1), 1)
    mean = jnp.where(near, depth[jnp.maximum(neighbors, 0)], 0.0).sum(axis=1) / count
    height = fit.height - crowding * jnp.sum(mean * fit.normal, axis=1)
    return height[:, None] * fit.normal


def _kernel(sq_dist: Float[Array, "n k"], width: Float[Array, " n"]) -> Float[Array, "n k"]:
    """The Gaussian of eq. (8); zero where there is no neighbour or no width."""
    near = jnp.isfinite(sq_dist) & (width > 0)[:, None]
    safe = jnp.where(width > 0, width, 1.0)[:, None]
    return jnp.where(near, jnp.exp(-jnp.where(near, sq_dist, 0.0) / (2.0 * jnp.square(safe))), 0.0)


def _estimate_alpha(offsets: Array, sq_dist: Array, noise: Array, valid: Array, order: int) -> Array:
    """The width at which a plane or quadric leaves out a quarter of the noise, as a share of the local noise, up to 1.

    Over a circle of radius R and a distance h, a plane leaves out h^2 / 2R and a quadric h^4 / 8R^3.
    """
    step = max(1, noise.shape[0] // PILOT)
    offsets, sq_dist, noise, valid = offsets[::step], sq_dist[::step], noise[::step], valid[::step]
    fit = fit_surface(offsets, _kernel(sq_dist, noise), order=2)
    usable = valid & (noise > 0) & jnp.isfinite(fit.bend)
    curve = jnp.maximum(jnp.abs(fit.bend), 1e-6 / jnp.where(usable, noise, 1.0))
    share = 0.25 * jnp.maximum(fit.noise, 1e-6 * noise)
    reach = jnp.sqrt(2.0 * share / curve) if order == 1 else (8.0 * share / curve**3) ** 0.25
    typical = jnp.nanmedian(jnp.where(usable, reach / jnp.where(usable, noise, 1.0), jnp.nan))
    return jnp.where(usable.any(), jnp.clip(typical, 0.3, 1.0), 1.0)


def _width(noise: Array, valid: Array, alpha, beta, form: str) -> Array:
    """Kernel widths `[n]`, eqs. (4) and (5)."""
    if form == "linear":
        return alpha * noise + (0.0 if beta is None else beta)
    median = jnp.where(valid.any(), jnp.nanmedian(jnp.where(valid, noise, jnp.nan)), 0.0)
    beta = median if beta is None else jnp.asarray(beta, dtype=noise.dtype)
    safe = jnp.where(beta > 0, beta, 1.0)
    return jnp.where(beta > 0, beta * jnp.exp(alpha * noise / safe), 0.0)


def _edge_weight(offsets: Array, sq_dist: Array, valid: Array, settings: _Settings) -> Array:
    """Weight of each point `[n]`, eqs. (6) and (7)."""
    apart = jnp.isfinite(sq_dist) & (sq_dist > 0)
    length = jnp.sqrt(jnp.where(apart, sq_dist, 1.0))
    gradient = jnp.where(apart[:, :, None], -offsets / length[:, :, None], 0.0).sum(axis=1)
    norm = jnp.sqrt(jnp.maximum(jnp.square(gradient).sum(axis=1), jnp.finfo(gradient.dtype).tiny))
    tau = settings.tau
    if tau is None:
        percentile = jnp.nanquantile(jnp.where(valid, norm, jnp.nan), 0.95)
        tau = jnp.where(valid.any(), percentile, 0.0)
    return 1.0 + settings.gamma * jnp.maximum(0.0, norm - tau)
