"""Normals of a cloud: the direction in which a neighbourhood varies least."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.eigen import symmetric_eigen
from cablejax.ops.neighbors import KnnResult, RadiusResult, knn, radius_search
from cablejax.ops.neighbors.request import bit
from cablejax.ops.precision import require_float32
from cablejax.ops.slots import Vector, offsets, sum_over_slots
from cablejax.types import Status

FLAT = 1e-5  # of the largest eigenvalue, by which the two smallest must differ to tell a normal: ten roundings


class NormalResult(NamedTuple):
    """The plane through each point's neighbourhood.

    Attributes:
        normals: Unit normals `[n, 3]`, zero where they are not determined and on padding.
        variation: Smallest eigenvalue of the neighbourhood's covariance, as a share of all three `[n]`: 0 on a plane, up to
            1/3 in a volume (Pauly et al. 2002).
        status: `Status` bits `[n]` int32: TOO_FEW_NEIGHBORS below two, DEGENERATE where they lie on a line or in one
            place, CAPACITY_EXCEEDED (a radius, and only the nearest k within it were used), NOT_FINITE. Zero on padding.
    """

    normals: Float[Array, "n 3"]
    variation: Float[Array, " n"]
    status: Int[Array, " n"]


@partial(jax.jit, static_argnames=("k",))
def estimate_normals(
    xyz: Float[Array, "n 3"],
    *,
    k: int = 20,
    radius: float | Float[Array, ""] | None = None,
    viewpoint: Float[Array, "3"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    found: KnnResult | RadiusResult | None = None,
) -> NormalResult:
    """Unit normals by principal components of each point and its neighbours (Hoppe et al. 1992).

    Their sign is arbitrary without a viewpoint; `orient_normals` makes it agree along the surface. Differentiable.

    Args:
        xyz: Points `[n, 3]`, any unit.
        k: Neighbours per point, the point itself not counted but used as well. Static.
        radius: In the unit of `xyz`: the nearest k within it are used; the nearest k wherever they lie if None.
        viewpoint: Place from which the surface was seen `[3]`: normals point to its side.
        mask: True where a row is a point `[n]`; all if None.
        found: The neighbours, from a search made elsewhere, in place of `k` and `radius`.

    Returns:
        Normals, how far from flat each place is, and status.

    Raises:
        ValueError: If `k` is below 2, `found` has another number of rows, or `xyz` is not float32.

    Example:
        >>> square = jnp.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
        >>> estimate_normals(square, k=3, viewpoint=jnp.array([0.0, 0.0, 9.0])).normals[0].round(3).tolist()
        [0.0, 0.0, 1.0]
    """
    require_float32(xyz=xyz)
    if viewpoint is not None and viewpoint.shape != (3,):
        raise ValueError(f"viewpoint: expected shape [3], got {list(viewpoint.shape)}")
    if found is None:
        if k < 2:
            raise ValueError(f"k: expected at least 2, to span a plane with the point itself, got {k}")
        near = knn(xyz, k=k, mask=mask) if radius is None else radius_search(xyz, radius=radius, capacity=k, mask=mask)
    elif found.neighbors.shape[0] != xyz.shape[0]:
        raise ValueError(f"found: expected {xyz.shape[0]} rows, got {found.neighbors.shape[0]}")
    else:
        near = found
    usable = jnp.isfinite(xyz).all(axis=1) if mask is None else mask & jnp.isfinite(xyz).all(axis=1)
    clean = jnp.where(usable[:, None], xyz, 0.0)
    count, covariance = _covariance(clean.T, near.neighbors.T)
    values, vectors = symmetric_eigen(covariance)
    determined = usable & (count > 2) & (values[:, 1] - values[:, 0] > FLAT * values[:, 2])
    normals = jnp.where(determined[:, None], vectors[:, 0], 0.0)
    if viewpoint is not None:
        away = jnp.sum(normals * (viewpoint[None, :] - clean), axis=1) < 0
        normals = jnp.where(away[:, None], -normals, normals)
    total = values.sum(axis=1)
    variation = jnp.where(total > 0, jnp.maximum(values[:, 0], 0.0) / jnp.where(total > 0, total, 1.0), 0.0)
    kept = near.status & int(Status.NOT_FINITE | Status.CAPACITY_EXCEEDED | Status.INVALID)
    few, flat = bit(usable & (count <= 2), Status.TOO_FEW_NEIGHBORS), bit(usable & ~determined, Status.DEGENERATE)
    return NormalResult(normals, jnp.where(usable, variation, 0.0), kept | jnp.where(few > 0, few, flat))


def _covariance(
    xyz: Float[Array, "3 n"], neighbors: Int[Array, "k n"]
) -> tuple[Int[Array, " n"], Float[Array, "n 3 3"]]:
    """Points in each neighbourhood, the point itself among them, and their covariance.

    About their mean, which is found first: products about the point itself would lose the digits of a stray's neighbours.
    """
    own = jnp.arange(xyz.shape[1], dtype=jnp.int32)[None]
    around = jnp.concatenate([own, neighbors.astype(jnp.int32)])

    def first(rows: Array, near: Array) -> tuple[Array, Vector]:
        return near.astype(jnp.int32), tuple(jnp.where(near, each, 0.0) for each in offsets(xyz, rows, xyz))

    count, total = sum_over_slots(around, first)
    mean = [each / count.astype(xyz.dtype) for each in total]

    def products(rows: Array, near: Array) -> Vector:
        off = zip(offsets(xyz, rows, xyz), mean, strict=True)
        x, y, z = (jnp.where(near, each - middle, 0.0) for each, middle in off)
        return x * x, x * y, x * z, y * y, y * z, z * z

    xx, xy, xz, yy, yz, zz = (each / count.astype(xyz.dtype) for each in sum_over_slots(around, products))
    rows = [jnp.stack(row, axis=-1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    return count, jnp.stack(rows, axis=-2)
