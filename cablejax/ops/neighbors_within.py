"""Count the points within a radius by the tree: blocks of 8 queries share the leaves that their box can reach."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors_brute import square_distances
from cablejax.ops.neighbors_descent import Near, children, descend
from cablejax.ops.neighbors_search import in_chunks, unproven
from cablejax.ops.neighbors_select import WORD
from cablejax.ops.neighbors_tree import Boxes, Tree

LEAVES = 96  # leaves that a block looks at; blocks that reach more compare with every point
ALONE = 64  # rows compared with every point at once


def count_within(
    xyz: Float[Array, "n 3"], valid: Bool[Array, " n"], tree: Tree, targets: Tree, square_radius: Float[Array, ""]
) -> Int[Array, " places"]:
    """How many points lie within the radius of each place of `targets`, the boundary and the point itself included.

    Args:
        xyz: The points searched.
        valid: True where a row of `xyz` is a point.
        tree: The same points as a tree.
        targets: The queries as a tree of the same depth; holes get counts without meaning.
        square_radius: The radius squared.
    """
    near = descend(tree, targets.levels[:-1])
    split = targets.row.shape[0] // near.node.shape[0]

    def below(first: Array, parents: int) -> tuple[Array, Array]:
        """Count for the leaves below some consecutive parents."""

        def cut(array: Array, axis: int, each: int) -> Array:
            return lax.dynamic_slice_in_dim(array, first * each, parents * each, axis)

        boxes = Boxes(*(cut(side, 1, split) for side in targets.levels[-1]))
        above = Near(cut(near.node, 0, 1), cut(near.bound, 0, 1))
        # A little more than the radius, so that rounding cannot leave out a leaf that touches it.
        reach = jnp.full(parents * split, 1.0) * square_radius * 1.00001 + 1e-30
        leaves = children(tree, len(tree.levels) - 1, above, boxes, reach, most=LEAVES)
        leaf = jnp.maximum(leaves.node, 0)
        there = (tree.row[leaf] >= 0) & (leaves.node >= 0)[:, :, None]
        points = jnp.where(there[None], tree.xyz[:, leaf], jnp.inf).reshape(3, parents * split, 1, -1, WORD)
        difference = cut(targets.xyz, 1, split)[:, :, :, None, None] - points
        inside = jnp.square(difference[0]) + jnp.square(difference[1]) + jnp.square(difference[2]) <= square_radius
        holes = cut(targets.row, 0, split) < 0
        done = (leaves.bound > square_radius)[:, None] | holes
        return inside.sum(axis=(-2, -1), dtype=jnp.int32).reshape(-1), done.reshape(-1)

    count, done = in_chunks(below, near.node.shape[0], split)
    return _by_all(xyz, valid, targets, square_radius, count, done)


def _by_all(xyz: Array, valid: Array, targets: Tree, square_radius: Array, count: Array, done: Array) -> Array:
    """Compare the rows whose leaves are too many with every point."""
    places, chunks = unproven(done, ALONE)
    queries = targets.xyz.reshape(3, -1)

    def once(state: tuple[Array, Array]) -> tuple[Array, Array]:
        i, count = state
        place = lax.dynamic_slice_in_dim(places, i * ALONE, ALONE)
        distance = square_distances(queries[:, jnp.minimum(place, count.shape[0] - 1)].T, xyz)
        inside = jnp.sum((distance <= square_radius) & valid[None, :], axis=1, dtype=jnp.int32)
        return i + 1, count.at[place].set(inside, mode="drop")

    return lax.while_loop(lambda s: s[0] < chunks, once, (jnp.int32(0), count))[1]
