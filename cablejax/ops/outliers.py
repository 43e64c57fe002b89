"""Outlier removal: statistical (section II.C of the paper), by radius, and by median."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors import KnnResult, distance_sums, knn, radius_count
from cablejax.ops.precision import require_float32
from cablejax.ops.quantile import quantile
from cablejax.types import PointCloud, Status


class OutlierResult(NamedTuple):
    """Which points to keep, and why.

    Attributes:
        keep: True where a point is no outlier `[n]`; False on padding.
        score: What was compared with the threshold `[n]`; 0 on padding.
        threshold: The bound on the score, in the score's unit.
        status: `Status` bits of the whole cloud, int32.
    """

    keep: Bool[Array, " n"]
    score: Float[Array, " n"]
    threshold: Float[Array, ""]
    status: Int[Array, ""]


@partial(jax.jit, static_argnames=("k",))
def statistical_outliers(
    cloud: PointCloud,
    *,
    k: int = 20,
    std_ratio: float | Float[Array, ""] = 2.0,
    found: KnnResult | None = None,
) -> OutlierResult:
    """Drop points whose mean neighbour distance exceeds the cloud's mean by `std_ratio` standard deviations.

    Section II.C of Su et al. (2025), steps 1 to 4. Equal to Open3D's `remove_statistical_outlier`, which counts the
    point itself, at distance zero, among its neighbours: `nb_neighbors = k` there is `k` here, and both average the
    k - 1 nearest other points and a zero. The threshold uses the sample standard deviation (n - 1), strictly (<). One
    difference: Open3D drops a point that has duplicates alone for neighbours, here it stays. Scores have a gradient where
    `found` is given.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        k: Neighbours per point, the point itself counted, as in Open3D. Static.
        std_ratio: Standard deviations above the mean at which a point is dropped.
        found: `knn(cloud.xyz, k=m, mask=cloud.mask)` for any m of at least k - 1, where that is at hand; searched if None.

    Returns:
        Points to keep, their mean neighbour distance, the threshold in the cloud's unit, and status.

    Raises:
        ValueError: If `k` is below 2, or `found` is not the neighbours of these points or has fewer than k - 1.
    """
    require_float32(cloud__xyz=cloud.xyz)
    if k < 2:
        raise ValueError(f"k: expected at least 2 (the point itself counts), got {k}")
    if found is None:
        total, near, status = distance_sums(cloud.xyz, k=k - 1, mask=cloud.mask)
        total = lax.stop_gradient(total)
    else:
        total, near, status = _sums_of(found, cloud, k - 1)
    return removal_by_sums(cloud, total, near, status, std_ratio)


def removal_by_sums(
    cloud: PointCloud,
    total: Float[Array, " n"],
    near: Int[Array, " n"],
    status: Int[Array, " n"],
    std_ratio: float | Float[Array, ""],
) -> OutlierResult:
    """`statistical_outliers` from what `distance_sums` gives."""
    score = total / (near + 1).astype(total.dtype)
    valid = _finite(cloud)
    count = valid.sum().astype(score.dtype)
    mean = jnp.where(valid, score, 0.0).sum() / jnp.maximum(count, 1.0)
    spread = jnp.square(jnp.where(valid, score - mean, 0.0)).sum() / jnp.maximum(count - 1.0, 1.0)
    threshold = mean + std_ratio * _root(spread)
    # Duplicates alone for neighbours are no outliers, whatever the threshold: where every point is there k times it is 0.
    keep = valid & ((score < threshold) | (score == 0)) & (near > 0)
    return OutlierResult(keep, score, threshold, _status(cloud, status))


@jax.jit
def radius_outliers(
    cloud: PointCloud, *, radius: float | Float[Array, ""], min_neighbors: int | Int[Array, ""]
) -> OutlierResult:
    """Drop points with too few neighbours within a radius: Open3D's `remove_radius_outlier`, its strict > included.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        radius: In the cloud's unit; one that is negative or NaN leaves `Status.INVALID` and keeps nothing.
        min_neighbors: A point is kept if more than this many points, itself counted, lie within `radius`.

    Returns:
        Points to keep, their count within the radius, `min_neighbors`, and status.
    """
    require_float32(cloud__xyz=cloud.xyz)
    found = radius_count(cloud.xyz, radius=radius, mask=cloud.mask, include_self=True)
    threshold = jnp.asarray(min_neighbors, dtype=jnp.float32)
    score = found.count.astype(jnp.float32)
    return OutlierResult(_finite(cloud) & (score > threshold), score, threshold, _status(cloud, found.status))


@partial(jax.jit, static_argnames=("k",))
def median_outliers(cloud: PointCloud, *, k: int = 20, ratio: float | Float[Array, ""] = 3.0) -> OutlierResult:
    """Drop points far from the median of their neighbours, in units of the cloud's median.

    The median filter of Table 1: a point's score is its distance to the coordinate-wise median of its k neighbours, which
    depends a little on how the axes lie.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        k: Neighbours per point, the point itself not counted. Static.
        ratio: A point is dropped where its score exceeds `ratio` times the median score of the cloud.

    Returns:
        Points to keep, their distance to the local median, the threshold in the cloud's unit, and status.

    Raises:
        ValueError: If `k` is below 1.
    """
    require_float32(cloud__xyz=cloud.xyz)
    found = knn(cloud.xyz, k=k, mask=cloud.mask)
    near = found.neighbors >= 0
    valid = _finite(cloud) & near.any(axis=1)
    xyz = jnp.where(valid[:, None], cloud.xyz, 0.0)
    offset = jnp.where(valid[:, None], xyz - _median(xyz[jnp.maximum(found.neighbors, 0)], near), 0.0)
    score = _root(jnp.square(offset).sum(axis=1))
    threshold = ratio * quantile(score, valid, 0.5)
    return OutlierResult(valid & (score <= threshold), score, threshold, _status(cloud, found.status))


def _sums_of(found: KnnResult, cloud: PointCloud, k: int) -> tuple[Array, Array, Array]:
    """Sums, numbers and status of the first k neighbours of a search made elsewhere, as `distance_sums` gives them."""
    n, m = found.sq_dist.shape
    if n != cloud.xyz.shape[0] or m < k:
        raise ValueError(f"found: expected neighbours [{cloud.xyz.shape[0]}, at least {k}], got {[n, m]}")
    near = jnp.isfinite(found.sq_dist[:, :k])
    total = _root(jnp.where(near, found.sq_dist[:, :k], 0.0)).sum(axis=1)
    few = _finite(cloud) & ~near[:, -1]
    status = (found.status & ~int(Status.TOO_FEW_NEIGHBORS)) | few.astype(jnp.int32) * int(Status.TOO_FEW_NEIGHBORS)
    return total, near.sum(axis=1, dtype=jnp.int32), status.astype(jnp.int32)


def _median(values: Float[Array, "n k 3"], valid: Bool[Array, "n k"]) -> Float[Array, "n 3"]:
    """Median of each row's valid values, coordinate by coordinate; 0 where there are none."""
    ordered = jnp.sort(jnp.where(valid[..., None], values, jnp.inf), axis=1)
    count = valid.sum(axis=1, dtype=jnp.int32)
    middle = (jnp.maximum(count - 1, 0) // 2, jnp.minimum(count // 2, valid.shape[1] - 1))
    low, high = (jnp.take_along_axis(ordered, at[:, None, None], axis=1)[:, 0] for at in middle)
    some = (count > 0)[:, None]
    return jnp.where(some, 0.5 * (jnp.where(some, low, 0.0) + jnp.where(some, high, 0.0)), 0.0)


def _root(square: Array) -> Array:
    """Square root whose gradient at 0 is 0: double where."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _finite(cloud: PointCloud) -> Array:
    """Rows that are points with finite coordinates."""
    return cloud.mask & jnp.isfinite(cloud.xyz).all(axis=1)


def _status(cloud: PointCloud, per_point: Array) -> Array:
    """The bits of the points or-ed together, with EMPTY and NOT_FINITE for the cloud."""
    valid = _finite(cloud)
    bits = {Status.EMPTY: ~valid.any(), Status.NOT_FINITE: (cloud.mask & ~valid).any()}
    for name in (Status.TOO_FEW_NEIGHBORS, Status.INVALID):
        bits[name] = ((per_point & int(name)) != 0).any()
    return sum(true.astype(jnp.int32) * int(bit) for bit, true in bits.items())  # pyright: ignore[reportReturnType]
