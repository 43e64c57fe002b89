"""A balanced tree of boxes over a cloud: rows sorted into leaves of 16, by equal splits along each node's longest side."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

LEAF = 16  # points per leaf: two leaves fill a word of 32 candidates
SPLIT = 16  # children per node, at most, where the depth is free


class Boxes(NamedTuple):
    """Axis-aligned boxes of one level; an empty box has lower = inf, upper = -inf.

    Attributes:
        lower: Smallest coordinates `[3, nodes]`.
        upper: Largest coordinates `[3, nodes]`.
    """

    lower: Float[Array, "3 nodes"]
    upper: Float[Array, "3 nodes"]


class Tree(NamedTuple):
    """A cloud in leaf order.

    Attributes:
        xyz: Coordinates `[3, leaves, 16]`; whatever stands in the holes.
        row: Row of each place in the cloud `[leaves, 16]` int32, -1 in holes.
        levels: Boxes from the root's children down to the leaves; children of a node are consecutive.
    """

    xyz: Float[Array, "3 leaves 16"]
    row: Int[Array, "leaves 16"]
    levels: tuple[Boxes, ...]


def depth_for(n: int) -> int:
    """Levels below the root for a cloud of n points."""
    return max(1, math.ceil(math.log(max(1.0, n / LEAF)) / math.log(SPLIT) - 1e-9))


def build(xyz: Float[Array, "n 3"], valid: Bool[Array, " n"], *, depth: int) -> Tree:
    """Sort a cloud into leaves by `depth` rounds of equal splits; invalid rows become holes in the last leaves.

    The splits need not be exact, as the boxes are measured from the points: each round sorts one 32-bit word per point, the
    coordinate's leading bits above the place, which is six times faster than sorting pairs.
    """
    n = xyz.shape[0]
    splits = _splits(-(-n // LEAF), depth)
    size = math.prod(splits) * LEAF
    rows = jnp.pad(jnp.where(valid, jnp.arange(n, dtype=jnp.int32), -1), (0, size - n), constant_values=-1)
    points = jnp.pad(xyz, ((0, size - n), (0, 0))).T
    nodes = 1
    for split in splits:
        place = _sorted_places(points.reshape(3, nodes, -1), rows.reshape(nodes, -1) >= 0)
        points, rows = points[:, place], rows[place]
        nodes *= split
    points, rows = points.reshape(3, nodes, LEAF), rows.reshape(nodes, LEAF)
    return Tree(points, rows, _levels(points, rows >= 0, splits))


def _splits(leaves: int, depth: int) -> list[int]:
    """Children per node and level, as equal as they come, so that their product reaches the number of leaves."""
    splits = []
    for level in range(depth):
        splits.append(math.ceil(leaves ** (1 / (depth - level)) - 1e-9))
        leaves = math.ceil(leaves / splits[-1])
    return splits


def _sorted_places(points: Float[Array, "3 nodes m"], valid: Bool[Array, "nodes m"]) -> Int[Array, " size"]:
    """Places in the order of each node's longest side, holes last."""
    nodes, m = valid.shape
    lower = jnp.min(jnp.where(valid, points, jnp.inf), axis=2)
    upper = jnp.max(jnp.where(valid, points, -jnp.inf), axis=2)
    side = jnp.where(upper > lower, upper - lower, 0.0)
    axis = jnp.argmax(side, axis=0)
    pick = jnp.arange(3)[:, None] == axis
    start = jnp.sum(jnp.where(pick, jnp.where(side > 0, lower, 0.0), 0.0), axis=0)
    length = jnp.sum(jnp.where(pick, side, 0.0), axis=0)
    along = jnp.sum(jnp.where(pick[:, :, None], points, 0.0), axis=0)
    place_bits = max(1, (m - 1).bit_length())
    top = 2 ** (32 - place_bits) - 2
    scale = jnp.where(length > 0, top / jnp.where(length > 0, length, 1.0), 0.0)
    cell = jnp.clip((along - start[:, None]) * scale[:, None], 0, top).astype(jnp.uint32)
    cell = jnp.where(valid, jnp.minimum(cell, jnp.uint32(top)), jnp.uint32(top + 1))
    packed = (cell << place_bits) | jnp.arange(m, dtype=jnp.uint32)
    place = (lax.sort(packed, dimension=1) & jnp.uint32(2**place_bits - 1)).astype(jnp.int32)
    return (place + jnp.arange(nodes, dtype=jnp.int32)[:, None] * m).reshape(-1)


def _levels(points: Array, valid: Array, splits: list[int]) -> tuple[Boxes, ...]:
    """Boxes of every level, root's children first."""
    lower = jnp.min(jnp.where(valid, points, jnp.inf), axis=2)
    upper = jnp.max(jnp.where(valid, points, -jnp.inf), axis=2)
    levels = [Boxes(lower, upper)]
    for split in reversed(splits[1:]):
        lower = lower.reshape(3, -1, split).min(axis=2)
        upper = upper.reshape(3, -1, split).max(axis=2)
        levels.append(Boxes(lower, upper))
    return tuple(reversed(levels))
