"""A balanced tree of boxes over a cloud: rows sorted into leaves of 8, by halving along each node's main axis.

A scanner's stray points would stretch the box of every leaf they fall into and make it everybody's neighbour. So points
far from the median of their leaf are taken out and fill leaves of their own below one more child of the root.

Every round of halving is the same program over arrays of one shape: a point's node is its place divided by the nodes'
size. The splits need not be exact, as boxes are measured from the points; so a node's axis and range are read off sixteen
of its points, and a round sorts one 32-bit word a point: node, leading bits of the coordinate, place.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

from cablejax.ops.varying import varying_like

LEAF = 8  # points per leaf: four leaves fill a word of 32 candidates
SPLIT = 8  # children of every node but the root
FIRST = 32  # children of the root, at most
SLABS = 7  # slabs that the root is cut into before halving, at most
SAMPLE = 8  # points of a node that tell its axis and range
STRAY = 80.0  # a stray's squared distance from its leaf's median point, in units of the leaf's median


class Boxes(NamedTuple):
    """Axis-aligned boxes; an empty box has lower = inf, upper = -inf.

    Attributes:
        lower: Smallest coordinates `[3, nodes]`.
        upper: Largest coordinates `[3, nodes]`.
    """

    lower: Float[Array, "3 nodes"]
    upper: Float[Array, "3 nodes"]

    def sides(self) -> Float[Array, "3 nodes"]:
        """Side lengths in space, zero for empty boxes; the further axis of a ragged batch has none."""
        return jnp.where(self.upper > self.lower, self.upper - self.lower, 0.0)[:3]


class Tree(NamedTuple):
    """A cloud in leaf order.

    Attributes:
        xyz: Coordinates `[3, leaves, 8]`; anything finite in the holes.
        row: Row of each place in the cloud `[leaves, 8]` int32, -1 in holes.
        boxes: Boxes of all nodes, the root's children first, then level by level down to the leaves; the eight children
            of a node are consecutive.
        box: Lengths of the periodic box along each axis, inf where it does not close `[3]`; none closes if None.
    """

    xyz: Float[Array, "3 leaves 8"]
    row: Int[Array, "leaves 8"]
    boxes: Boxes
    box: Float[Array, " 3"] | None = None

    def level_sizes(self) -> tuple[int, ...]:
        """Nodes per level, from the root's children to the leaves."""
        sizes = [self.row.shape[0]]
        while sizes[0] > FIRST:
            sizes.insert(0, sizes[0] // SPLIT)
        return tuple(sizes)

    def first_stray_leaf(self) -> int:
        """Leaves from here on hold strays: those below the root's last child."""
        sizes = self.level_sizes()
        return sizes[-1] - sizes[-1] // sizes[0]


def build(xyz: Float[Array, "n 3"], valid: Bool[Array, " n"]) -> Tree:
    """Sort a cloud into the leaves of a tree; invalid rows become holes."""
    n = xyz.shape[0]
    slabs, halvings, depth = _shape(-(-n // LEAF))
    size = slabs * LEAF << halvings
    rows = jnp.pad(jnp.where(valid, jnp.arange(n, dtype=jnp.int32), -1), (0, size - n), constant_values=-1)
    points, rows = _cut(jnp.pad(xyz, ((0, size - n), (0, 0))).T, rows)
    early = halvings // 2  # large nodes are few, and small ones are sorted faster
    points, rows = _halve(points, rows, slabs, early)
    points, rows = _halve(points, rows, slabs << early, halvings - early)
    points, rows = points.reshape(3, -1, LEAF), rows.reshape(-1, LEAF)
    stray = _strays(points, rows >= 0)
    few = SPLIT**depth * LEAF
    place = true_places(stray.reshape(-1), few)
    stray_rows = rows.reshape(-1).at[place].get(mode="fill", fill_value=-1)
    stray_points = points.reshape(3, -1).at[:, place].get(mode="fill", fill_value=0.0)
    rows = rows.reshape(-1).at[place].set(-1, mode="drop").reshape(-1, LEAF)
    points = jnp.concatenate([points, stray_points.reshape(3, -1, LEAF)], axis=1)
    rows = jnp.concatenate([rows, stray_rows.reshape(-1, LEAF)])
    return Tree(points, rows, boxes_of(points, rows >= 0, depth))


def _shape(leaves: int) -> tuple[int, int, int]:
    """Slabs, halvings of each until it is a leaf, and levels below the root's children, for at least so many leaves."""
    halvings = max(0, math.ceil(math.log2(max(leaves, 1) / SLABS) - 1e-9))
    slabs = -(-leaves // 2**halvings)
    return slabs, halvings, halvings // 3


def _cut(points: Float[Array, "3 size"], rows: Int[Array, " size"]) -> tuple[Array, Array]:
    """Order all points along the axis on which they spread most, holes last."""
    size = rows.shape[0]
    place = jnp.asarray(np.arange(1024) * size // 1024 if size > 1024 else np.arange(size), dtype=jnp.int32)
    axis, start, scale = _main_axis(points[:, None, place], rows[None, place] >= 0)
    bits = max(1, (size - 1).bit_length())
    key = _cells(points, rows, axis, start, scale, 32 - bits) << bits | jnp.arange(size, dtype=jnp.uint32)
    order = (lax.sort(key) & np.uint32(2**bits - 1)).astype(jnp.int32)
    return _take(points, order), _take(rows, order)


def _halve(points: Float[Array, "3 size"], rows: Int[Array, " size"], nodes: int, halvings: int) -> tuple[Array, Array]:
    """Halve nodes of equal size so many times; the points of each new node stay together."""
    if halvings == 0:
        return points, rows
    size = rows.shape[0]
    bits = (size // nodes - 1).bit_length()
    cell_bits = 32 - bits
    step_bits = SAMPLE.bit_length() - 1
    place = jnp.arange(size, dtype=jnp.uint32)

    def once(done: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        points, rows = state
        node_bits = (bits - done).astype(jnp.int32)  # a node holds 2 ** node_bits places
        first = jnp.minimum(jnp.arange(nodes << (halvings - 1), dtype=jnp.int32), (nodes << done) - 1) << node_bits
        step = jnp.arange(SAMPLE, dtype=jnp.int32) << (node_bits - step_bits)
        at = first[:, None] + step[None, :]
        axis, start, scale = _main_axis(_take(points, at), _take(rows, at) >= 0)
        shift = node_bits.astype(jnp.uint32)
        node = (place >> shift).astype(jnp.int32)
        axis, start, scale = (_take(each, node) for each in (axis, start, scale))
        cell = _cells(points, rows, axis, start, scale, cell_bits)
        in_old = (place & np.uint32(2**bits - 1)) >> shift
        within = (jnp.uint32(1) << shift) - 1
        key = ((in_old << cell_bits | cell) << shift | (place & within)).reshape(nodes, -1)
        # XLA sorts in one thread, but two sorts that do not wait for each other at once.
        parts = (key[: nodes // 2], key[nodes // 2 :])
        key = jnp.concatenate([lax.sort(part, dimension=1) for part in parts]).reshape(-1)
        order = ((place & ~within) | (key & within)).astype(jnp.int32)
        return _take(points, order), _take(rows, order)

    return lax.fori_loop(0, halvings, once, varying_like((points, rows), rows))


def _take(array: Array, at: Array) -> Array:
    """The given places of the last axis, which are in bounds."""
    return array.at[..., at].get(mode="promise_in_bounds")


def _main_axis(sample: Float[Array, "3 nodes s"], valid: Bool[Array, "nodes s"]) -> tuple[Array, Array, Array]:
    """The axis along which each node's sample spreads most, where it starts there, and one over its length.

    The spread is the mean distance from the mean: unlike the sides of the box it follows the many, not the strays.
    """
    count = jnp.maximum(jnp.sum(valid, axis=1, dtype=jnp.int32), 1).astype(jnp.float32)[None, :]
    lower = jnp.min(jnp.where(valid[None], sample, jnp.inf), axis=2)
    upper = jnp.max(jnp.where(valid[None], sample, -jnp.inf), axis=2)
    lower, upper = jnp.where(lower < jnp.inf, lower, 0.0), jnp.where(upper > -jnp.inf, upper, 0.0)
    inside = jnp.where(valid[None], sample - lower[:, :, None], 0.0)
    mean = jnp.sum(inside, axis=2) / count
    spread = jnp.sum(jnp.where(valid[None], jnp.abs(inside - mean[:, :, None]), 0.0), axis=2)
    axis = jnp.argmax(spread, axis=0).astype(jnp.int32)
    pick = jnp.arange(3, dtype=jnp.int32)[:, None] == axis[None, :]
    start = jnp.sum(jnp.where(pick, lower, 0.0), axis=0)
    length = jnp.sum(jnp.where(pick, upper - lower, 0.0), axis=0)
    return axis, start, jnp.where(length > 0, 1.0 / jnp.where(length > 0, length, 1.0), 0.0)


def _cells(points: Array, rows: Array, axis: Array, start: Array, scale: Array, bits: int) -> UInt[Array, " size"]:
    """The leading bits of each point's coordinate along its node's axis; all ones for holes."""
    top = 2**bits - 2
    along = jnp.where(axis == 0, points[0], jnp.where(axis == 1, points[1], points[2]))
    share = jnp.clip((along - start) * scale, 0.0, 1.0)
    cell = jnp.minimum((share * np.float32(top)).astype(jnp.uint32), np.uint32(top))
    return jnp.where(rows >= 0, cell, np.uint32(top + 1))


def _strays(points: Float[Array, "3 leaves 8"], valid: Bool[Array, "leaves 8"]) -> Bool[Array, "leaves 8"]:
    """Points much farther from the median point of their leaf than half of the leaf is."""
    half = (jnp.sum(valid, axis=1, dtype=jnp.int32) - 1) // 2
    centre = _nth(points.reshape(-1, LEAF), jnp.tile(valid, (3, 1)), jnp.tile(half, 3)).reshape(3, -1)
    sq_dist = jnp.square(points - centre[:, :, None]).sum(axis=0)
    return valid & (sq_dist > STRAY * _nth(sq_dist, valid, half)[:, None])


def _nth(values: Float[Array, "m 8"], valid: Bool[Array, "m 8"], n: Int[Array, " m"]) -> Float[Array, " m"]:
    """The n-th smallest valid value of each row, by counting."""
    values = jnp.where(valid, values, jnp.inf)
    earlier = jnp.asarray(np.arange(LEAF)[None, :] < np.arange(LEAF)[:, None])
    near, far = values[:, None, :], values[:, :, None]
    rank = jnp.sum((near < far) | ((near == far) & earlier[None]), axis=2, dtype=jnp.int32)
    return jnp.sum(jnp.where(rank == n[:, None], jnp.where(valid, values, 0.0), 0.0), axis=1)


def true_places(mask: Bool[Array, " n"], size: int | None = None) -> Int[Array, " size"]:
    """Where a mask is True, in order; n behind the last, and nothing of what is more than `size`, n if None.

    As `jnp.nonzero`, which compiles two sums for this one.
    """
    n = mask.shape[0]
    size = n if size is None else size
    at = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, size)
    return jnp.full(size, n, dtype=jnp.int32).at[at].set(jnp.arange(n, dtype=jnp.int32), mode="drop")


def boxes_of(points: Float[Array, "a leaves 8"], valid: Bool[Array, "leaves 8"], depth: int) -> Boxes:
    """Boxes of all nodes, the root's children first."""
    lower = [jnp.min(jnp.where(valid[None], points, jnp.inf), axis=2)]
    upper = [jnp.max(jnp.where(valid[None], points, -jnp.inf), axis=2)]
    for _ in range(depth):
        lower.insert(0, lower[0].reshape(len(points), -1, SPLIT).min(axis=2))
        upper.insert(0, upper[0].reshape(len(points), -1, SPLIT).max(axis=2))
    return Boxes(jnp.concatenate(lower, axis=1), jnp.concatenate(upper, axis=1))
