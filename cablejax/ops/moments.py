"""Masked moments of point sets, and the local moments of eqs. (2) and (3)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.slots import Vector, offsets, sq_length, sum_over_slots


class LocalMoments(NamedTuple):
    """First and second moments of each point's neighbourhood.

    Attributes:
        found: Neighbours found `[n]` int32.
        mean: Their centroid `[n, 3]`, eq. (3); zero where there is none.
        variance: Their mean squared distance to it `[n]`, eq. (2).
        covariance: Their covariance matrix `[n, 3, 3]`, whose trace is the variance.
    """

    found: Int[Array, " n"]
    mean: Float[Array, "n 3"]
    variance: Float[Array, " n"]
    covariance: Float[Array, "n 3 3"]


def local_moments(xyz: Float[Array, "n 3"], neighbors: Int[Array, "n k"]) -> LocalMoments:
    """Moments of each point's neighbourhood, eqs. (2) and (3).

    Args:
        xyz: Points `[n, 3]`, any unit.
        neighbors: Row numbers `[n, k]`, -1 where there is none; include the point itself to count it.

    Returns:
        Number, mean, variance and covariance of the neighbours of each point.

    Example:
        >>> xyz = jnp.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
        >>> local_moments(xyz, jnp.array([[0, 1], [0, 1]])).variance.tolist()
        [1.0, 1.0]
    """
    found = neighbors >= 0
    near = xyz[jnp.maximum(neighbors, 0)]
    return LocalMoments(
        found=found.sum(axis=-1, dtype=jnp.int32),
        mean=masked_mean(near, found),
        variance=masked_variance(near, found),
        covariance=masked_covariance(near, found),
    )


def local_noise(
    xyz: Float[Array, "3 n"], centre: Float[Array, "3 m"], neighbors: Int[Array, "k m"]
) -> Float[Array, " m"]:
    """Local noise sigma_i: root of the summed variances of each neighbourhood's coordinates, eqs. (2) and (3).

    The root of `local_moments(...).variance`, slot by slot: what the filters run.

    Args:
        xyz: Coordinates `[3, n]`, any unit.
        centre: A place near each neighbourhood `[3, m]`; sums are taken from it, so that they keep their digits.
        neighbors: Rows of each neighbourhood `[k, m]`, the point itself among them, -1 where there is none.
    """

    def sums(rows: Array, near: Array) -> tuple[Array, Vector, Array]:
        offset = tuple(jnp.where(near, each, 0.0) for each in offsets(xyz, rows, centre))
        return near.astype(xyz.dtype), offset, sq_length(offset)

    count, first, square = sum_over_slots(neighbors, sums)
    count = jnp.maximum(count, 1.0)
    variance = square / count - sq_length(tuple(each / count for each in first))
    positive = variance > 0
    # Double where: the root has no gradient at 0.
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)


def masked_mean(values: Float[Array, "*b n c"], mask: Bool[Array, "..."]) -> Float[Array, "*b c"]:
    """Mean over the valid rows `[..., n, c]`, eq. (3); zero where none is valid.

    Example:
        >>> masked_mean(jnp.array([[1.0], [3.0], [99.0]]), jnp.array([True, True, False])).tolist()
        [2.0]
    """
    if values.shape[:-1] != mask.shape:
        raise ValueError(f"mask: expected shape {list(values.shape[:-1])}, got {list(mask.shape)}")
    count = jnp.maximum(mask.sum(axis=-1, keepdims=True, dtype=values.dtype), 1)
    first = jnp.take_along_axis(values, jnp.argmax(mask, axis=-1)[..., None, None], axis=-2)
    # Relative to one of the points: a sum of coordinates far from the origin loses the digits that matter.
    offsets = jnp.where(mask[..., None], values - first, 0.0)
    mean = jnp.where(mask.any(axis=-1)[..., None], first[..., 0, :], 0.0) + offsets.sum(axis=-2) / count
    return mean


def masked_variance(values: Float[Array, "*b n c"], mask: Bool[Array, "..."]) -> Float[Array, "*b"]:
    """Mean squared distance of the valid rows from their mean, eq. (2); zero where none is valid.

    Example:
        >>> masked_variance(jnp.array([[1.0], [3.0], [99.0]]), jnp.array([True, True, False])).tolist()
        1.0
    """
    centred = jnp.where(mask[..., None], values - masked_mean(values, mask)[..., None, :], 0.0)
    return jnp.square(centred).sum(axis=(-2, -1)) / jnp.maximum(mask.sum(axis=-1, dtype=values.dtype), 1)


def masked_covariance(values: Float[Array, "*b n c"], mask: Bool[Array, "..."]) -> Float[Array, "*b c c"]:
    """Covariance `[..., c, c]` of the valid rows, divided by their number; its trace is `masked_variance`."""
    centred = jnp.where(mask[..., None], values - masked_mean(values, mask)[..., None, :], 0.0)
    count = jnp.maximum(mask.sum(axis=-1, dtype=values.dtype), 1)
    return jnp.einsum("...ni,...nj->...ij", centred, centred) / count[..., None, None]
