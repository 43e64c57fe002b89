"""A balanced tree of boxes over a cloud: rows sorted into leaves of 8, by halving along each node's main axis.

A scanner's stray points would stretch the box of every leaf they fall into and make it everybody's neighbour. So points
far from the median of their leaf are taken out and fill leaves of their own, in the order that they have, below one more
child of the root. Sorting them once more made no search faster, and took a fifth of the time to compile one.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

LEAF = 8  # points per leaf: four leaves fill a word of 32 candidates
FIRST = 16  # children of the root, at most
SPLIT = 8  # children per node below, at most
STRAY = 80.0  # a stray's squared distance from its leaf's median point, in units of the leaf's median


class Boxes(NamedTuple):
    """Axis-aligned boxes of one level; an empty box has lower = inf, upper = -inf.

    Attributes:
        lower: Smallest coordinates `[3, nodes]`.
        upper: Largest coordinates `[3, nodes]`.
    """

    lower: Float[Array, "3 nodes"]
    upper: Float[Array, "3 nodes"]

    def sides(self) -> Float[Array, "3 nodes"]:
        """Side lengths, zero for empty boxes."""
        return jnp.where(self.upper > self.lower, self.upper - self.lower, 0.0)


class Tree(NamedTuple):
    """A cloud in leaf order.

    Attributes:
        xyz: Coordinates `[3, leaves, 8]`; anything in the holes.
        row: Row of each place in the cloud `[leaves, 8]` int32, -1 in holes.
        levels: Boxes from the root's children down to the leaves; children of a node are consecutive.
    """

    xyz: Float[Array, "3 leaves 8"]
    row: Int[Array, "leaves 8"]
    levels: tuple[Boxes, ...]


def depth_for(n: int) -> int:
    """Levels below the root for a cloud of n points."""
    return 1 + math.ceil(math.log(max(1.0, n / LEAF / FIRST)) / math.log(SPLIT) - 1e-9)


def build(xyz: Float[Array, "n 3"], valid: Bool[Array, " n"], *, depth: int) -> Tree:
    """Sort a cloud into the leaves of a tree with `depth` levels below the root; invalid rows become holes.

    The root is cut into slabs, every node below is halved along its main axis until it is a leaf. Splits by 16 instead of
    halves build in half the time, but leave slivers: on a scan a leaf had 30 others within reach instead of 12.

    The splits need not be exact, as boxes are measured from the points: each round sorts one 32-bit word per point, the
    coordinate's leading bits above the place, which is six times faster than sorting pairs.
    """
    n = xyz.shape[0]
    splits = _splits(-(-n // LEAF), depth)
    size = math.prod(splits) * LEAF
    rows = jnp.pad(jnp.where(valid, jnp.arange(n, dtype=jnp.int32), -1), (0, size - n), constant_values=-1)
    points, rows = _sort(jnp.pad(xyz, ((0, size - n), (0, 0))).T, rows, splits)
    stray = _strays(points, rows >= 0)
    few = size // splits[0]
    own = jnp.nonzero(stray.reshape(-1), size=few, fill_value=-1)[0]
    taken = jnp.zeros(size, dtype=bool).at[jnp.where(own < 0, size, own)].set(True, mode="drop").reshape(rows.shape)
    stray_rows = jnp.where(own < 0, -1, rows.reshape(-1)[own])
    stray_points, stray_rows = points.reshape(3, -1)[:, own].reshape(3, -1, LEAF), stray_rows.reshape(-1, LEAF)
    rows = jnp.where(taken, -1, rows)
    trunk, branch = _levels(points, rows >= 0, splits), _levels(stray_points, stray_rows >= 0, [1, *splits[1:]])
    levels = [
        Boxes(*(jnp.concatenate(side, axis=1) for side in zip(*pair, strict=True)))
        for pair in zip(trunk, branch, strict=True)
    ]
    return Tree(jnp.concatenate([points, stray_points], axis=1), jnp.concatenate([rows, stray_rows]), tuple(levels))


def _splits(leaves: int, depth: int) -> list[int]:
    """Children per node and level: up to 16 of the root, powers of two below, so that their product reaches `leaves`."""
    halvings = max(0, math.ceil(math.log2(leaves / FIRST) - 1e-9))
    halvings = min(halvings, 3 * (depth - 1))
    first = -(-leaves // 2**halvings)
    return [first, *(2 ** ((halvings + level) // (depth - 1)) for level in range(depth - 1))]


def _sort(points: Float[Array, "3 m"], rows: Int[Array, " m"], splits: list[int]) -> tuple[Array, Array]:
    """Split nodes again and again; points `[3, leaves, 8]` and their rows `[leaves, 8]`."""
    nodes = 1
    for split in [splits[0], *(2 for below in splits[1:] for _ in range(below.bit_length() - 1))]:
        if split > 1:
            place = _sorted_places(points.reshape(3, nodes, -1), rows.reshape(nodes, -1) >= 0)
            points, rows = points[:, place], rows[place]
        nodes *= split
    return points.reshape(3, nodes, LEAF), rows.reshape(nodes, LEAF)


def _sorted_places(points: Float[Array, "3 nodes m"], valid: Bool[Array, "nodes m"]) -> Int[Array, " size"]:
    """Places in the order along the axis on which each node spreads most, holes last."""
    nodes, m = valid.shape
    box = _boxes(points, valid)
    side = box.sides()
    pick = jnp.arange(3)[:, None] == jnp.argmax(_spread(points, valid, box), axis=0)[None, :]
    start = jnp.sum(jnp.where(pick & (side > 0), box.lower, 0.0), axis=0)
    length = jnp.sum(jnp.where(pick, side, 0.0), axis=0)
    along = jnp.sum(jnp.where(pick[:, :, None], points, 0.0), axis=0)
    place_bits = max(1, (m - 1).bit_length())
    top = 2 ** (32 - place_bits) - 2
    scale = jnp.where(length > 0, top / jnp.where(length > 0, length, 1.0), 0.0)
    cell = jnp.clip((along - start[:, None]) * scale[:, None], 0, top).astype(jnp.uint32)
    cell = jnp.where(valid, jnp.minimum(cell, jnp.uint32(top)), jnp.uint32(top + 1))
    packed = (cell << place_bits) | jnp.arange(m, dtype=jnp.uint32)[None, :]
    # XLA sorts in one thread, but two sorts that do not wait for each other at once.
    parts = jnp.split(packed, 2) if nodes % 2 == 0 else [packed]
    ordered = jnp.concatenate([lax.sort(part, dimension=1) for part in parts])
    place = (ordered & jnp.uint32(2**place_bits - 1)).astype(jnp.int32)
    return (place + jnp.arange(nodes, dtype=jnp.int32)[:, None] * m).reshape(-1)


def _spread(points: Float[Array, "3 nodes m"], valid: Bool[Array, "nodes m"], box: Boxes) -> Float[Array, "3 nodes"]:
    """Mean distance from the mean along each axis: unlike the sides of the box it follows the many, not the strays."""
    count = jnp.maximum(jnp.sum(valid, axis=1), 1)[None, :, None]
    inside = jnp.where(valid[None], points - jnp.where(box.lower < jnp.inf, box.lower, 0.0)[:, :, None], 0.0)
    mean = jnp.sum(inside, axis=2, keepdims=True) / count
    return jnp.sum(jnp.where(valid[None], jnp.abs(inside - mean), 0.0), axis=2) / count[:, :, 0]


def _strays(points: Float[Array, "3 leaves 8"], valid: Bool[Array, "leaves 8"]) -> Bool[Array, "leaves 8"]:
    """Points much farther from the median point of their leaf than half of the leaf is."""
    half = (jnp.sum(valid, axis=1) - 1) // 2
    centre = jnp.stack([_nth(axis, valid, half) for axis in points])
    sq_dist = jnp.square(points - centre[:, :, None]).sum(axis=0)
    return valid & (sq_dist > STRAY * _nth(sq_dist, valid, half)[:, None])


def _nth(values: Float[Array, "leaves 8"], valid: Bool[Array, "leaves 8"], n: Int[Array, " leaves"]) -> Array:
    """The n-th smallest valid value of each row, by counting."""
    values = jnp.where(valid, values, jnp.inf)
    earlier = jnp.arange(LEAF)[None, :] < jnp.arange(LEAF)[:, None]
    near, far = values[:, None, :], values[:, :, None]
    rank = jnp.sum((near < far) | ((near == far) & earlier[None]), axis=2)
    return jnp.sum(jnp.where(rank == n[:, None], jnp.where(valid, values, 0.0), 0.0), axis=1)


def _boxes(points: Float[Array, "3 nodes m"], valid: Bool[Array, "nodes m"]) -> Boxes:
    """Boxes of the valid points of each node."""
    lower = jnp.min(jnp.where(valid[None], points, jnp.inf), axis=2)
    return Boxes(lower, jnp.max(jnp.where(valid[None], points, -jnp.inf), axis=2))


def _levels(points: Array, valid: Array, splits: list[int]) -> list[Boxes]:
    """Boxes of every level, root's children first."""
    levels = [_boxes(points, valid)]
    for split in reversed(splits[1:]):
        lower, upper = levels[-1]
        levels.append(Boxes(lower.reshape(3, -1, split).min(axis=2), upper.reshape(3, -1, split).max(axis=2)))
    return levels[::-1]
