"""Count the points within a radius by the tree: blocks of 8 queries share the leaves that their box can reach."""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.descent import descend, root
from cablejax.ops.neighbors.metric import square_length
from cablejax.ops.neighbors.select import LARGEST
from cablejax.ops.neighbors.tree import FIRST, LEAF, Boxes, Tree
from cablejax.ops.varying import varying_like

CHUNK = 512  # blocks counted at once
Round = tuple[Int[Array, " b"], Int[Array, "b 8"]]  # the leaf to go on from, and what was counted


def count_within(
    tree: Tree, targets: Tree, queries: int, square_radius: Float[Array, ""], *, include_self: bool
) -> Int[Array, " queries"]:
    """How many points lie within the radius of each query, the boundary included.

    Leaves within reach are looked at in their order, some a round, until none is left. Strays are counted one by one, as
    the box of several would reach too far.

    Args:
        tree: The points searched.
        targets: The queries as a tree.
        queries: Rows of output. Static.
        square_radius: The radius squared.
        include_self: Whether a query counts its own row. Static.

    Returns:
        Counts in the order of the queries' rows; 0 for rows that are not in `targets`.
    """
    blocks, places = targets.first_stray_leaf(), targets.row.size
    first = np.arange(blocks)[:, None] * LEAF + np.arange(LEAF)[None, :]
    alone = np.where(np.arange(LEAF)[None, :] == 0, np.arange(blocks * LEAF, places)[:, None], -1)
    items = np.concatenate([first, alone])
    items = np.pad(items, ((0, -len(items) % CHUNK), (0, 0)), constant_values=-1).reshape(-1, CHUNK, LEAF)
    rows, xyz = targets.row.reshape(-1), targets.xyz.reshape(len(targets.xyz), -1)

    def chunk(place: Int[Array, "b 8"]) -> tuple[Array, Array]:
        at = jnp.maximum(place, 0)
        there = (place >= 0) & (rows[at] >= 0)
        own = jnp.full_like(place, -1) if include_self else rows[at]
        return jnp.where(there, rows[at], queries), _count(tree, xyz[:, at], there, own, square_radius)

    row, count = lax.map(chunk, jnp.asarray(items, dtype=jnp.int32))
    zeros = jnp.zeros(queries, dtype=jnp.int32)
    return zeros.at[row.reshape(-1)].set(count.reshape(-1), mode="drop")


def _count(
    tree: Tree, xyz: Float[Array, "a b 8"], there: Bool[Array, "b 8"], own: Int[Array, "b 8"], square_radius: Array
) -> Int[Array, "b 8"]:
    """Count for one chunk of blocks."""
    blocks, leaves = there.shape[0], tree.row.shape[0]
    lower = jnp.min(jnp.where(there[None], xyz, jnp.inf), axis=2)
    boxes = Boxes(lower, jnp.max(jnp.where(there[None], xyz, -jnp.inf), axis=2))
    # A little more than the radius, so that rounding cannot leave out a leaf that touches it.
    reach = jnp.minimum(square_radius * 1.00001 + 1e-30, LARGEST) * jnp.ones(blocks, dtype=jnp.float32)
    in_order, depth = jnp.ones(blocks, dtype=bool), len(tree.level_sizes()) - 1

    def once(state: Round) -> Round:
        start, count = state
        above = root(tree, blocks, FIRST)
        near = descend(tree, above, boxes, levels=(0, depth), most=FIRST, in_order=in_order, reach=reach, start=start)
        leaf = jnp.maximum(near.node, 0)
        row = jnp.where((near.node >= 0)[:, :, None], tree.row[leaf], -1).reshape(blocks, 1, -1)
        difference = xyz[:, :, :, None] - tree.xyz[:, leaf].reshape(len(xyz), blocks, 1, -1)
        sq_dist = square_length(difference, tree.box)
        inside = (row >= 0) & (row != own[:, :, None]) & (sq_dist <= square_radius)
        return near.resume, count + jnp.sum(inside, axis=2, dtype=jnp.int32)

    started = jnp.where(jnp.any(there, axis=1), 0, leaves).astype(jnp.int32)
    first = (started, jnp.zeros(there.shape, dtype=jnp.int32))
    # Blocks that are done find nothing more, as no leaf comes after the last.
    return lax.while_loop(lambda s: jnp.any(s[0] < leaves), once, varying_like(first, tree, xyz, square_radius))[1]
