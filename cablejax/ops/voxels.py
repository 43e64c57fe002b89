"""Voxel means: one point for every cell of a grid that holds any."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.request import as_float32, bit, prepare
from cablejax.types import Status


class VoxelResult(NamedTuple):
    """A cloud thinned to the means of its voxels, in the order of the voxels along the first axis, then the next.

    Attributes:
        xyz: Means `[capacity, c]`, zeros where there are fewer voxels. Differentiable in the coordinates.
        count: Points of each voxel `[capacity]` int32, zero where there are fewer; `count > 0` is the thinned cloud's mask.
        voxel: The voxel of each point `[n]` int32, -1 for padding and where the capacity left none: any other quantity is
            averaged by `jax.ops.segment_sum`.
        total: How many voxels hold points, also beyond the capacity `[]` int32.
        status: `Status` bits `[]` int32: CAPACITY_EXCEEDED where the last voxels found no room, EMPTY, NOT_FINITE, and
            INVALID for a size that is not positive.
    """

    xyz: Float[Array, "capacity c"]
    count: Int[Array, " capacity"]  # pyright: ignore[reportIncompatibleMethodOverride]
    voxel: Int[Array, " n"]
    total: Int[Array, ""]
    status: Int[Array, ""]


@partial(jax.jit, static_argnames=("capacity",))
def voxel_downsample(
    xyz: Float[Array, "n c"],
    *,
    size: float | Float[Array, ""],
    capacity: int | None = None,
    mask: Bool[Array, " n"] | None = None,
    origin: Float[Array, " c"] | None = None,
) -> VoxelResult:
    """The mean of the points in each voxel, and how many they are.

    A point belongs to the voxel `floor((xyz - origin) / size)`. Voxels are told apart by their numbers along each axis, not
    by a hash, and means are taken from a point of the voxel, so that nothing is lost far from the origin.

    Args:
        xyz: Points `[n, c]`, any unit.
        size: Side of the voxels, in that unit.
        capacity: Voxels there is room for; n, which is always enough, if None. Static.
        mask: True where a row is a point `[n]`; all if None.
        origin: A corner of the grid `[c]`; the least coordinates of the cloud if None, which keeps most digits.

    Returns:
        Means, counts, the voxel of each point, and status.

    Raises:
        ValueError: If `capacity` is below 1, the shapes do not fit together, or coordinates are float64 or integers.

    Example:
        >>> thin = voxel_downsample(jnp.array([[0.0], [2.5], [0.5], [2.75]]), size=1.0, capacity=3)
        >>> thin.xyz[:, 0].tolist(), thin.count.tolist(), thin.voxel.tolist()
        ([0.25, 2.625, 0.0], [2, 2, 0], [0, 1, 0, 1])
    """
    n, c = xyz.shape
    capacity = n if capacity is None else capacity
    if capacity < 1:
        raise ValueError(f"capacity: expected at least 1, got {capacity}")
    if jnp.ndim(size) > 0:
        raise ValueError(f"size: expected one number, got shape {list(jnp.shape(size))}")
    if origin is not None and origin.shape != (c,):
        raise ValueError(f"origin: expected shape [{c}], got {list(origin.shape)}")
    points = prepare(xyz, mask)
    size = lax.stop_gradient(jnp.asarray(size, dtype=jnp.float32))
    good = (size > 0) & jnp.isfinite(size)
    usable = points.usable() & good
    corner = jnp.min(jnp.where(usable[:, None], points.xyz, jnp.inf), axis=0) if origin is None else origin
    corner = lax.stop_gradient(jnp.where(jnp.isfinite(corner), corner, 0.0))
    cell = jnp.floor((points.xyz - corner[None, :]) / jnp.where(good, size, 1.0))
    # Cells stay floats, which hold every whole number that coordinates of float32 can tell apart.
    keys = [jnp.where(usable, cell[:, axis], jnp.inf) for axis in range(c)]
    *keys, order = lax.sort((*keys, jnp.arange(n, dtype=jnp.int32)), num_keys=c, is_stable=True)
    there = keys[0] < jnp.inf
    new = jnp.zeros(n, dtype=bool).at[0].set(True)
    for key in keys:
        new = new.at[1:].set(new[1:] | (key[1:] != key[:-1]))
    number = jnp.cumsum(new & there, dtype=jnp.int32) - 1
    total = jnp.sum(new & there, dtype=jnp.int32)
    kept = there & (number < capacity)
    number = jnp.where(kept, number, capacity)
    first = jnp.nonzero(new & there, size=capacity, fill_value=0)[0].astype(jnp.int32)
    ordered = jnp.where(usable[:, None], as_float32(xyz, "xyz"), 0.0)[order]
    base = ordered[first]
    offset = jnp.where(kept[:, None], ordered - base[jnp.minimum(number, capacity - 1)], 0.0)
    sums = jax.ops.segment_sum(offset, number, num_segments=capacity, indices_are_sorted=True)
    count = jax.ops.segment_sum(kept.astype(jnp.int32), number, num_segments=capacity, indices_are_sorted=True)
    means = jnp.where((count > 0)[:, None], base + sums / jnp.maximum(count, 1)[:, None], 0.0)
    voxel = jnp.zeros(n, jnp.int32).at[order].set(jnp.where(kept, number, -1))
    bits = {
        Status.CAPACITY_EXCEEDED: total > capacity,
        Status.EMPTY: ~jnp.any(points.usable()),
        Status.NOT_FINITE: jnp.any(points.asked & ~points.finite),
        Status.INVALID: ~good,
    }
    return VoxelResult(means, count, voxel, total, sum((bit(true, name) for name, true in bits.items()), jnp.int32(0)))
