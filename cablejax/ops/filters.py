"""The adaptive filter of eqs. (4)-(8), and variants on the same weights that do not shrink a cable."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cablejax.ops.moments import local_noise
from cablejax.ops.neighbors import KnnResult, ListAndSums, knn
from cablejax.ops.precision import require_float32
from cablejax.ops.quantile import quantile
from cablejax.ops.sheets import own_sheet
from cablejax.ops.slots import Neighborhoods, Vector, offsets, sq_length, sum_over_slots
from cablejax.ops.surface_filter import gaussian, onto_surface, surface_width
from cablejax.ops.surface_fit import inverse
from cablejax.types import PointCloud, Status

Number = float | Float[Array, ""]


class FilterResult(NamedTuple):
    """A filtered cloud.

    Attributes:
        xyz: Filtered points `[n, 3]`; rows of padding and points that are not finite come back unchanged.
        width: Kernel width of each point `[n]`, sigma_f of eq. (4), in the cloud's unit; 0 where nothing was filtered.
        status: `Status` bits `[n]` int32: TOO_FEW_NEIGHBORS, NOT_FINITE, and LOWER_ORDER where the neighbours do not
            determine the surface asked for, so that a plane, the mean or the point itself was taken.
    """

    xyz: Float[Array, "n 3"]
    width: Float[Array, " n"]
    status: Int[Array, " n"]


def adaptive_filter(
    cloud: PointCloud,
    *,
    k: int = 100,
    alpha: Number | None = None,
    beta: Number | None = None,
    gamma: Number | None = None,
    tau: Number | None = None,
    order: int = 0,
    form: str = "linear",
    iterations: int = 1,
    refinements: int = 1,
    crowding: Number | None = None,
    usual_noise: Number | None = None,
    found: KnnResult | ListAndSums | None = None,
) -> FilterResult:
    """Smooth each point with a Gaussian as wide as its local noise.

    Eqs. (2)-(8) of Su et al. (2025). Eq. (5) prints the width as sigma_i; it is read as sigma_f of eq. (4).
    A neighbourhood is the point and its k nearest; eq. (6) leaves the point itself out, where it would be 0/0.

    The weighted mean of eq. (8) lies inside a curved surface: a cable comes out too thin. `order` 1 and 2 move each point
    along its normal onto a plane or quadric fitted with the same weights, from which neighbours through a thin wall are left
    out (`own_sheet`). Where the neighbours do not determine it (few of
    them, on a grid, along a line), the point goes onto the plane, or else to the mean, and its status says so; no point
    moves farther than its neighbours lie.

    Args:
        cloud: Points `[n, 3]` float32, any unit, with validity `[n]`.
        k: Neighbours per point, the point itself not counted; an upper bound on how many get weight. Static.
        alpha: Kernel width per unit of local noise, eq. (5). If None, 1 for order 0; otherwise the width at which
            neighbours best predict a point without it, at 2,048 of the points (`filter_width`): wide on noisy clouds,
            narrow on clean or strongly curved ones, a constant to gradients.
        beta: Least kernel width, in the cloud's unit, eq. (5); if None, 0 (linear) or the median local noise.
        gamma: Extra weight per unit of gradient above `tau`, eq. (7); none if None or 0.
        tau: Gradient norm above which a point counts as an edge, eq. (7); the cloud's 95th percentile if None.
        order: Degree of the local surface: 0 the paper's mean, 1 a plane, 2 a quadric. Static.
        form: "linear" is eq. (5), "exponential" is beta * exp(alpha * sigma_i / beta). Static.
        iterations: How often the filter is applied, each time to the last result. Static.
        refinements: With orders 1 and 2, how often the measured points are fitted again with weights from the surface just
            found: by distance between points on it, and between their normals. Nothing is smoothed twice. To gradients what
            they add is a constant. Static.
        crowding: With order 2, how much of the pull of noise along the normal is put back: such points crowd inside a
            curved surface, and their mean lies noise^2 times the sum of the curvatures too deep. 1 if noise is along the
            normal alone, 1/2 for equal noise in all directions, none (None or 0) for noise along a scanner's beams.
        usual_noise: With orders 1 and 2, the standard deviation off their surface that is usual for points of this cloud,
            in its unit. Where a fit leaves far more (an edge, a wall that is thin for the kernel), the kernel narrows, to
            half at least. If None, it is estimated along with `alpha`, and no kernel narrows where `alpha` is given.
        found: The `knn` of the cloud for at least one neighbour, in place of a search with `k`: neighbours whose mask is
            False do not count, so the search may have been made before outliers were masked. For the first iteration.

    Returns:
        Filtered points `[n, 3]`, widths `[n]` in the cloud's unit, and a status per point.

    Raises:
        ValueError: If `k` or `iterations` is below 1, `refinements` below 0, `order` is not 0, 1 or 2, `form` is neither
            word, `found` is of a cloud of another size, or the points are not float32.

    Example:
        >>> line = jnp.stack([jnp.arange(9.0), jnp.zeros(9), jnp.zeros(9)], axis=1).at[4, 2].set(0.5)
        >>> result = adaptive_filter(PointCloud.from_xyz(line), k=4)
        >>> bool(result.xyz[4, 2] < 0.5)
        True
    """
    _check(cloud, k=k, order=order, form=form, iterations=iterations, refinements=refinements, found=found)
    # Decided here, outside jit: what a stage's absence spares must not depend on how its default was written.
    given = {
        "alpha": _scalar(1.0 if alpha is None and order == 0 else alpha),
        "beta": _scalar(_unless_zero(beta) if form == "linear" else beta),
        "gamma": _scalar(_unless_zero(gamma)),
        "tau": None if _unless_zero(gamma) is None else _scalar(tau),
        "crowding": _scalar(_unless_zero(crowding)) if order == 2 else None,
        "usual_noise": _scalar(usual_noise) if order else None,
    }
    options = {"k": k, "order": order, "form": form, "refinements": refinements if order else 0}
    return _filter(cloud, found, given, iterations=iterations, **options)


def _check(cloud: PointCloud, *, k, order, form, iterations, refinements, found) -> None:
    require_float32(cloud__xyz=cloud.xyz)
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


def _unless_zero(value: Number | None) -> Number | None:
    return None if isinstance(value, int | float) and value == 0 else value


def _scalar(value: Number | None) -> Float[Array, ""] | None:
    return None if value is None else jnp.asarray(value, dtype=jnp.float32)


@partial(jax.jit, static_argnames=("k", "order", "form", "iterations", "refinements"))
def _filter(
    cloud: PointCloud,
    found: KnnResult | ListAndSums | None,
    given: dict[str, Array | None],
    *,
    iterations: int,
    **options,
) -> FilterResult:
    """All applications of the filter."""
    result = _once(cloud, found, given, **options)
    for _ in range(iterations - 1):
        again = _once(PointCloud(result.xyz, cloud.mask), None, given, **options)
        result = FilterResult(again.xyz, again.width, again.status | result.status)
    return result


def _once(cloud: PointCloud, found, given, *, k: int, order: int, form: str, refinements: int) -> FilterResult:
    """One application of the filter."""
    around, status = neighborhoods(cloud, found, k)
    noise = local_noise(around.xyz, around.xyz, around.neighbors)
    if order:
        around = around._replace(neighbors=own_sheet(around.xyz, around.xyz, around.neighbors, noise))
        noise = local_noise(around.xyz, around.xyz, around.neighbors)
    edge = None if given["gamma"] is None else _edge_weight(around, given["gamma"], given["tau"])
    alpha, usual = given["alpha"], given["usual_noise"]
    if alpha is None:
        alpha, usual = surface_width(around, noise, order)
    width = _width(noise, around.valid, alpha, given["beta"], form)
    if order == 0:
        move = _mean_offset(around, edge, width)
    else:
        moved = onto_surface(around, edge, width, usual, given["crowding"], order, refinements)
        move, width = moved.move, moved.width
        lower = around.valid & (width > 0) & (moved.degree < order)
        status = status | lower.astype(jnp.int32) * int(Status.LOWER_ORDER)
    held = jnp.isfinite(move).all(axis=0)  # coordinates whose squares overflow
    status = status | (around.valid & ~held).astype(jnp.int32) * int(Status.NOT_FINITE)
    filtered = around.valid & (width > 0) & held
    xyz = jnp.where(filtered[:, None], cloud.xyz + jnp.where(filtered[None], move, 0.0).T, cloud.xyz)
    return FilterResult(xyz, jnp.where(filtered, width, 0.0), status)


def neighborhoods(
    cloud: PointCloud, found: KnnResult | ListAndSums | None, k: int
) -> tuple[Neighborhoods, Int[Array, " n"]]:
    """Each point with its k nearest in slots, and the status of each point."""
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
        status = jnp.where(cloud.mask, status, 0) | few.astype(jnp.int32) * int(Status.TOO_FEW_NEIGHBORS)
    xyz = jnp.where(valid[:, None], cloud.xyz, 0.0).T
    return Neighborhoods(xyz, jnp.concatenate([own[None], near]), valid), status.astype(jnp.int32)


def _width(noise: Array, valid: Array, alpha: Array, beta: Array | None, form: str) -> Float[Array, " n"]:
    """Kernel widths, eqs. (4) and (5)."""
    if form == "linear":
        return alpha * noise + (0.0 if beta is None else beta)
    beta = quantile(noise, valid, 0.5) if beta is None else beta
    safe = jnp.where(beta > 0, beta, 1.0)
    return jnp.where(beta > 0, beta * jnp.exp(alpha * noise / safe), 0.0)


def _edge_weight(around: Neighborhoods, gamma: Array, tau: Array | None) -> Float[Array, " n"]:
    """Weight of each point, eqs. (6) and (7)."""

    def sums(rows: Array, near: Array) -> Vector:
        offset = offsets(around.xyz, rows, around.xyz)
        sq_dist = sq_length(offset)
        apart = near & (sq_dist > 0)
        distance = jnp.sqrt(jnp.where(apart, sq_dist, 1.0))
        return tuple(jnp.where(apart, each / distance, 0.0) for each in offset)

    square = sq_length(sum_over_slots(around.neighbors, sums))
    positive = square > 0
    # Double where: the root has no gradient at 0.
    norm = jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
    tau = quantile(norm, around.valid, 0.95) if tau is None else tau
    return 1.0 + gamma * jnp.maximum(0.0, norm - tau)


def _mean_offset(around: Neighborhoods, edge: Array | None, width: Array) -> Float[Array, "3 n"]:
    """From each point to the mean of eq. (8)."""

    def sums(rows: Array, near: Array) -> tuple[Array, Vector]:
        offset = offsets(around.xyz, rows, around.xyz)
        weight = gaussian(sq_length(offset), near, width)
        weight = weight if edge is None else weight * edge[rows]
        return weight, tuple(weight * each for each in offset)

    total, move = sum_over_slots(around.neighbors, sums)
    return jnp.stack(move) * inverse(total)[None]
