"""The adaptive filter of equations (2)-(8), and variants on the same weights that do not shrink a cable."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.filter_width import BAND, Trial, choose_alpha, pilot_step, try_widths
from cablejax.ops.neighbors import KnnResult, ListAndSums, knn
from cablejax.ops.quantile import quantile
from cablejax.ops.slots import gather, sum_over_slots
from cablejax.ops.surface_fit import TINY, SurfaceFit, fit_surface
from cablejax.types import PointCloud, Status

FACING = 0.6  # normals that differ by so much, as a distance of unit vectors, count as one kernel width apart


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


class _Around(NamedTuple):
    """A cloud with its neighbourhoods, slot by slot.

    Attributes:
        xyz: Coordinates `[3, n]`, 0 where there is no point.
        neighbors: The point itself, then its neighbours `[k + 1, n]`, -1 where there is none.
        valid: `[n]`.
    """

    xyz: Float[Array, "3 n"]
    neighbors: Int[Array, "k n"]
    valid: Array


@partial(jax.jit, static_argnames=("k", "order", "form", "iterations", "refinements"))
def adaptive_filter(
    cloud: PointCloud,
    *,
    k: int = 100,
    alpha: float | Float[Array, ""] | None = None,
    beta: float | Float[Array, ""] | None = None,
    gamma: float | Float[Array, ""] = 0.0,
    tau: float | Float[Array, ""] | None = None,
    order: int = 0,
    form: str = "linear",
    iterations: int = 1,
    refinements: int = 1,
    crowding: float | Float[Array, ""] = 0.0,
    found: KnnResult | ListAndSums | None = None,
) -> FilterResult:
    """Smooth each point with a Gaussian as wide as its local noise.

    Equations (2)-(8) of Su et al. (2025). Equation (5) prints the width as sigma_i; it is read as sigma_f of eq. (4).
    A neighbourhood is the point and its k nearest; eq. (6) leaves the point itself out, where it would be 0/0.

    The weighted mean of eq. (8) lies inside a curved surface: a cable comes out too thin. `order` 1 and 2 move each point
    along its normal onto a plane or quadric fitted with the same weights.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        k: Neighbours per point, the point itself not counted; an upper bound on how many get weight. Static.
        alpha: Kernel width per unit of local noise, eq. (5). If None, 1 for order 0; otherwise the width at which
            neighbours best predict a point without it, at 2,048 of the points (`filter_width`): wide on noisy clouds,
            narrow on clean or strongly curved ones, a constant to gradients.
        beta: Least kernel width, in the cloud's unit, eq. (5); if None, 0 (linear) or the median local noise.
        gamma: Extra weight per unit of gradient above `tau`, eq. (7).
        tau: Gradient norm above which a point counts as an edge, eq. (7); the cloud's 95th percentile if None.
        order: Degree of the local surface: 0 the paper's mean, 1 a plane, 2 a quadric. Static.
        form: "linear" is eq. (5), "exponential" is beta * exp(alpha * sigma_i / beta). Static.
        iterations: How often the filter is applied, each time to the last result. Static.
        refinements: With orders 1 and 2, how often the measured points are fitted again with weights from the surface just
            found: by distance between points on it, and between their normals. Nothing is smoothed twice. Static.
        crowding: With order 2, how much of the pull of noise along the normal is put back: such points crowd inside a
            curved surface, and their mean lies noise^2 times the sum of the curvatures too deep. 1 if noise is along the
            normal alone, 1/2 for equal noise in all directions, 0 for noise along a scanner's beams.
        found: The `knn` of the cloud for at least one neighbour, in place of a search with `k`: neighbours whose mask is
            False do not count, so the search may have been made before outliers were masked. For the first iteration.

    Returns:
        Filtered points `[n, 3]`, widths `[n]` in the cloud's unit, and a status per point.

    Raises:
        ValueError: If `k` or `iterations` is below 1, `refinements` below 0, `order` is not 0, 1 or 2, `form` is neither
            word, or `found` is of a cloud of another size.
    """
    _check(cloud, k=k, order=order, form=form, iterations=iterations, refinements=refinements, found=found)
    settings = _Settings(alpha, beta, gamma, tau, crowding)
    result = _once(cloud, found, settings, k=k, order=order, form=form, refinements=refinements)
    for _ in range(iterations - 1):
        last = PointCloud(result.xyz, cloud.mask)
        again = _once(last, None, settings, k=k, order=order, form=form, refinements=refinements)
        result = FilterResult(again.xyz, again.width, again.status | result.status)
    return result


def _check(cloud: PointCloud, *, k, order, form, iterations, refinements, found) -> None:
    if k < 1:
        raise ValueError(f"k: expected at least 1, got {k}")
    if order not in (0, 1, 2):
        raise ValueError(f"order: expected 0, 1 or 2, got {order}")
    if form not in ("linear", "exponential"):
        raise ValueError(f'form: expected "linear" or "exponential", got {form!r}')
    if iterations < 1:
        raise ValueError(f"iterations: expected at least 1, got {iterations}")
    if refinements < 0:
        raise ValueError(f"refinements: expected at least 0, got {refinements}")
    if found is not None and found.neighbors.shape[0] != cloud.xyz.shape[0]:
        raise ValueError(f"found: expected {cloud.xyz.shape[0]} rows, got {found.neighbors.shape[0]}")


@partial(jax.jit, static_argnames=("k", "order"))
def width_trial(cloud: PointCloud, keep: Bool[Array, " n"], rows: Int[Array, " m"], *, k: int, order: int) -> Trial:
    """What the estimate of `alpha` rests on, for some rows of a cloud; `choose_alpha` makes one number of it.

    For clouds that come in parts: the trials of all parts side by side are the trial of the whole, if together they hold
    every `pilot_step(n)`-th row.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        keep: Which of them are no outliers `[n]`: the neighbours are the kept ones among the k nearest of all.
        rows: Which to predict `[m]`; -1 for none.
        k: Neighbours per point. Static.
        order: 1 or 2. Static.
    """
    at = jnp.maximum(rows, 0)
    search = knn(cloud.xyz, k=k + 1, queries=cloud.xyz[at], mask=cloud.mask)
    near = search.neighbors.T
    used = (rows >= 0) & keep[at]
    near = jnp.where((near >= 0) & (near != rows[None]) & used[None] & keep[jnp.maximum(near, 0)], near, -1)
    neighbors = jnp.concatenate([jnp.where(used, rows, -1)[None], near])
    xyz = jnp.where(cloud.mask[:, None] & jnp.isfinite(cloud.xyz), cloud.xyz, 0.0).T
    centre = xyz[:, at]
    local = _local_noise(xyz, centre, neighbors)
    return try_widths(xyz, centre, neighbors, jnp.where(used, local, 0.0), order=order)


def _around(cloud: PointCloud, found: KnnResult | ListAndSums | None, k: int) -> tuple[_Around, Array]:
    """Neighbourhoods in slots, and the status of each point."""
    search = knn(cloud.xyz, k=k, mask=cloud.mask) if found is None else found
    finite = jnp.isfinite(cloud.xyz).all(axis=1)
    valid = cloud.mask & finite
    near = search.neighbors.T
    if found is not None:
        near = jnp.where((near >= 0) & valid[None] & valid[jnp.maximum(near, 0)], near, -1)
    own = jnp.where(valid, jnp.arange(valid.shape[0], dtype=near.dtype), -1)
    status = search.status
    if found is not None:
        few = valid & (near < 0).all(axis=0)
        status = jnp.where(cloud.mask, status, 0) | few * int(Status.TOO_FEW_NEIGHBORS)
    xyz = jnp.where(valid[:, None], cloud.xyz, 0.0).T
    return _Around(xyz, jnp.concatenate([own[None], near]), valid), status.astype(jnp.int32)


def _once(cloud: PointCloud, found, settings: _Settings, *, k: int, order: int, form: str, refinements: int):
    """One application of the filter."""
    around, status = _around(cloud, found, k)
    noise = _local_noise(around.xyz, around.xyz, around.neighbors)
    plain = isinstance(settings.gamma, int | float) and settings.gamma == 0
    edge = None if plain else _edge_weight(around, settings)
    alpha = settings.alpha
    if alpha is None:
        alpha = 1.0 if order == 0 else _estimate_alpha(around, noise, order)
    width = _width(noise, around.valid, alpha, settings.beta, form)
    if order == 0:
        move = _mean_offset(around, edge, width)
    else:
        move = _onto_surface(around, edge, width, settings.crowding, order, refinements)
    moved = around.valid & (width > 0)
    xyz = jnp.where(moved[:, None], cloud.xyz + move.T, cloud.xyz)
    return FilterResult(xyz, jnp.where(moved, width, 0.0), status)


def _local_noise(xyz: Float[Array, "3 n"], centre: Float[Array, "3 m"], neighbors: Int[Array, "k m"]) -> Array:
    """Root of the summed variances of each neighbourhood's coordinates `[m]`, eqs. (2) and (3)."""

    def sums(rows: Array, near: Array) -> tuple[Array, Array, Array]:
        offset = jnp.where(near[None], gather(xyz, rows) - centre, 0.0)
        return near.astype(offset.dtype), offset, jnp.square(offset).sum(axis=0)

    count, first, square = sum_over_slots(neighbors, sums)
    count = jnp.maximum(count, 1.0)
    variance = square / count - jnp.square(first / count[None]).sum(axis=0)
    positive = variance > 0
    # Double where: the root has no gradient at 0.
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)


def _estimate_alpha(around: _Around, noise: Array, order: int) -> Array:
    step = pilot_step(noise.shape[0])
    xyz, local = lax.stop_gradient((around.xyz, jnp.where(around.valid, noise, 0.0)[::step]))
    return choose_alpha(try_widths(xyz, xyz[:, ::step], around.neighbors[:, ::step], local, order=order))


def _kernel(sq_dist: Array, near: Array, width: Array) -> Array:
    """The Gaussian of eq. (8); zero where there is no neighbour or no width."""
    safe = jnp.where(width > 0, width, 1.0)
    near = near & (width > 0)
    return jnp.where(near, jnp.exp(-jnp.where(near, sq_dist, 0.0) / (2.0 * jnp.square(safe))), 0.0)


def _mean_offset(around: _Around, edge: Array | None, width: Array) -> Float[Array, "3 n"]:
    """From each point to the mean of eq. (8)."""

    def sums(rows: Array, near: Array) -> tuple[Array, Array]:
        offset = gather(around.xyz, rows) - around.xyz
        weight = _kernel(jnp.square(offset).sum(axis=0), near, width)
        weight = weight if edge is None else weight * edge[rows]
        return weight, weight[None] * offset

    total, move = sum_over_slots(around.neighbors, sums)
    return move / jnp.maximum(total, TINY)[None]


def _onto_surface(around: _Around, edge, width: Array, crowding, order: int, refinements: int) -> Float[Array, "3 n"]:
    """From each point along its normal onto its plane or quadric."""
    fit = _fit(around, around.xyz, None, edge, width, order)
    move = fit.height[None] * fit.normal
    for _ in range(refinements):
        place = around.xyz + move
        fit = _fit(around, place, fit.normal, _trusted(edge, move, fit.noise), width, order)
        move = move + fit.height[None] * fit.normal
    if order == 2 and not (isinstance(crowding, int | float) and crowding == 0):
        move = move - crowding * _depth(around, fit)
    return move


def _trusted(edge: Array | None, move: Array, noise: Array) -> Array:
    """Weight of each point, less where it lies farther from its own surface than noise explains: a mixed pixel, a stray."""
    beyond = jnp.square(move).sum(axis=0) / jnp.maximum(jnp.square(BAND * noise), TINY)
    trust = jnp.exp(-0.5 * beyond)
    return trust if edge is None else edge * trust


def _fit(
    around: _Around, place: Array, normal: Array | None, edge: Array | None, width: Array, order: int
) -> SurfaceFit:
    """Surfaces through the measured points about given places, weighted by distance between places and normals."""
    at = place if normal is None else jnp.concatenate([place, normal])

    def sample(rows: Array, near: Array) -> tuple[Array, Array]:
        other = gather(at, rows)
        weight = _kernel(jnp.square(other[:3] - place).sum(axis=0), near, width)
        if normal is not None:
            cosine = jnp.abs((other[3:] * normal).sum(axis=0))  # normals have either sign
            weight = weight * jnp.exp((cosine - 1.0) / FACING**2)
        offset = (other[:3] if normal is None else gather(around.xyz, rows)) - place
        return weight if edge is None else weight * edge[rows], offset

    return fit_surface(sample, around.neighbors, order=order)


def _depth(around: _Around, fit: SurfaceFit) -> Float[Array, "3 n"]:
    """How deep crowding has pulled each surface, along its normal.

    One fit's curvature is far noisier than its height, so the mean over the neighbours is taken, as a vector: their
    normals have either sign.
    """
    depth = (jnp.square(fit.noise) * fit.bend)[None] * fit.normal

    def sums(rows: Array, near: Array) -> tuple[Array, Array]:
        return near.astype(depth.dtype), jnp.where(near[None], gather(depth, rows), 0.0)

    count, total = sum_over_slots(around.neighbors, sums)
    mean = total / jnp.maximum(count, 1.0)[None]
    return (mean * fit.normal).sum(axis=0)[None] * fit.normal


def _width(noise: Array, valid: Array, alpha, beta, form: str) -> Array:
    """Kernel widths `[n]`, eqs. (4) and (5)."""
    if form == "linear":
        return alpha * noise + (0.0 if beta is None else beta)
    beta = quantile(noise, valid, 0.5) if beta is None else jnp.asarray(beta, dtype=noise.dtype)
    safe = jnp.where(beta > 0, beta, 1.0)
    return jnp.where(beta > 0, beta * jnp.exp(alpha * noise / safe), 0.0)


def _edge_weight(around: _Around, settings: _Settings) -> Float[Array, " n"]:
    """Weight of each point, eqs. (6) and (7)."""

    def sums(rows: Array, near: Array) -> Array:
        offset = around.xyz - gather(around.xyz, rows)
        sq_dist = jnp.square(offset).sum(axis=0)
        apart = near & (sq_dist > 0)
        return jnp.where(apart[None], offset / jnp.sqrt(jnp.where(apart, sq_dist, 1.0))[None], 0.0)

    gradient = sum_over_slots(around.neighbors, sums)
    norm = jnp.sqrt(jnp.maximum(jnp.square(gradient).sum(axis=0), TINY))
    tau = settings.tau
    if tau is None:
        tau = quantile(norm, around.valid, 0.95)
    return 1.0 + settings.gamma * jnp.maximum(0.0, norm - tau)
