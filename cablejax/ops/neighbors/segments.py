"""Ragged batches: many clouds of any size in one array, told apart by row splits, and searched as one.

The clouds share one tree and one search, so a slow cloud costs its own queries and holds up no other. They are kept apart
by a further axis on which their points lie so far from each other that the squared distance is infinite; within a cloud
the difference along it is zero, and distances are what they are without it, to the last bit.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.tree import Tree, boxes_of, build

APART = 2.0**65  # between two clouds along the further axis: its square is beyond float32, and a multiple of it exact


def segments_of(row_splits: Int[Array, " b1"], n: int) -> tuple[Int[Array, " n"], Bool[Array, ""]]:
    """The cloud of each of n rows, -1 for rows of none, and whether the splits ascend within `[0, n]`."""
    splits = row_splits.astype(jnp.int32)
    good = (splits[0] >= 0) & jnp.all(splits[1:] >= splits[:-1]) & (splits[-1] <= n)
    segment = jnp.searchsorted(splits, jnp.arange(n, dtype=jnp.int32), side="right").astype(jnp.int32) - 1
    return jnp.where(good & (segment < splits.shape[0] - 1), segment, -1), good


def with_segment(xyz: Float[Array, "n c"], segment: Int[Array, " n"]) -> Float[Array, "n c1"]:
    """Coordinates with the further axis."""
    return jnp.concatenate([xyz, segment.astype(jnp.float32)[:, None] * APART], axis=1)


def build_segments(xyz: Float[Array, "n 3"], valid: Bool[Array, " n"], segment: Int[Array, " n"]) -> Tree:
    """Sort the points of many clouds into one tree over four axes.

    The order is that of the clouds scaled to unit size and put in a row along the first axis. It need not be exact, as
    boxes are measured from the points themselves.
    """
    n = xyz.shape[0]
    cloud = jnp.maximum(segment, 0)
    there = valid[:, None]
    low = jax.ops.segment_min(jnp.where(there, xyz, jnp.inf), cloud, num_segments=n)
    high = jax.ops.segment_max(jnp.where(there, xyz, -jnp.inf), cloud, num_segments=n)
    side = jnp.max(jnp.where(high > low, high - low, 0.0), axis=1)
    scaled = (xyz - jnp.where(low < jnp.inf, low, 0.0)[cloud]) / jnp.where(side > 0, side, 1.0)[cloud, None]
    in_a_row = scaled.at[:, 0].add(2.0 * cloud.astype(jnp.float32))
    tree = build(jnp.where(there, in_a_row, 0.0), valid)
    points = with_segment(xyz, cloud).T[:, jnp.maximum(tree.row, 0)]
    return Tree(points, tree.row, boxes_of(points, tree.row >= 0, len(tree.level_sizes()) - 1))
