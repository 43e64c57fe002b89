"""From the root of a tree to the leaves near each of many boxes, by one loop over the levels.

Nearest first, a box keeps the nearest nodes of every level, and a bound on the distance of all that it left out. In order,
it keeps the first nodes within its reach from a given leaf on, and the leaf at which it has to go on.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.metric import gap
from cablejax.ops.neighbors.select import LARGEST, WORD, apart, columns, narrow, selected
from cablejax.ops.neighbors.tree import SPLIT, Boxes, Tree
from cablejax.ops.varying import varying_like


class Near(NamedTuple):
    """Nodes of one level near each of b boxes.

    Attributes:
        node: Numbers within their level `[b, m]` int32, ascending if taken in order; -1 where there are fewer.
        bound: Nearest first, no point outside these nodes is nearer to a point of the box `[b]`, squared; LARGEST where
            none is left out.
        resume: In order, all leaves within reach before this one lie below these nodes `[b]` int32; the number of leaves
            if none is left.
    """

    node: Int[Array, "b m"]
    bound: Float[Array, " b"]
    resume: Int[Array, " b"]


def root(tree: Tree, b: int, width: int) -> Near:
    """The root's children, from which nothing is left out, for b boxes."""
    number = np.arange(width, dtype=np.int32)
    first = jnp.asarray(np.where(number < tree.level_sizes()[0], number, -1))
    return Near(
        jnp.tile(first, (b, 1)),
        jnp.full(b, LARGEST, dtype=jnp.float32),
        jnp.full(b, tree.row.shape[0], dtype=jnp.int32),
    )


def descend(
    tree: Tree,
    near: Near,
    boxes: Boxes,
    *,
    levels: tuple[int | Array, int | Array],
    most: int,
    in_order: Bool[Array, " b"],
    reach: Float[Array, " b"],
    start: Int[Array, " b"],
    beyond: Float[Array, " b"] | None = None,
    patience: int | Int[Array, ""] = 0,
) -> Near:
    """Go down from the nodes of one level to those of another.

    Args:
        tree: The points searched.
        near: Nodes of the level where to begin.
        boxes: Where to search `[3, b]`; empty boxes find nothing.
        levels: The level of `near` and the level where to stop.
        most: Leaves kept, no more than `near` has room for; as many as that of any other level. Static.
        in_order: Whether a box takes its nodes in order, from leaf `start` on, within `reach`; nearest first if not `[b]`.
        reach: Squared distance within which leaves are wanted, in order `[b]`.
        start: First leaf that is wanted, in order `[b]`.
        beyond: Squared distance beyond which leaves are wanted, nearest first `[b]`; all are if None.
        patience: So many boxes may get fewer nodes than they could where a longer search would find more.

    Returns:
        Nodes of the last level. Nearest first: all of them, or up to a sixth fewer than `most`.
    """
    sizes, width = tree.level_sizes(), near.node.shape[1]
    leaves = len(sizes) - 1
    offset = jnp.asarray(np.cumsum([0, *sizes[:-1]]), dtype=jnp.int32)
    span = jnp.asarray([SPLIT ** (len(sizes) - 1 - i) for i in range(len(sizes))], dtype=jnp.int32)
    guess = jnp.maximum(1e-30, jnp.square(jnp.max(boxes.sides(), axis=0)))
    active = (boxes.upper[0] >= boxes.lower[0]) & ~in_order
    numbers = jnp.arange(SPLIT, dtype=jnp.int32)[None, None, :]

    def down(level: Array, near: Near) -> Near:
        level = level.astype(jnp.int32) + 1
        keep = jnp.where(level == leaves, most, width).astype(jnp.int32)
        child = near.node[:, :, None] * SPLIT + numbers
        child = jnp.where(near.node[:, :, None] >= 0, child, -1).reshape(near.node.shape[0], -1)
        child = jnp.pad(child, ((0, 0), (0, -child.shape[1] % WORD)), constant_values=-1)
        lowest = jnp.where(in_order, start // span[level], 0)
        nearer = jnp.full_like(reach, -1.0) if beyond is None else jnp.where(in_order | (level < leaves), -1.0, beyond)
        at = jnp.where(child >= lowest[:, None], child + offset[level], -1)
        sure = jnp.all(near.resume >= 0)
        score = apart(_gaps, sure, tree.boxes, tree.box, at, boxes, nearer)
        score = score.reshape(child.shape[0], -1, WORD)
        words = score.shape[1]
        found = narrow(
            lambda scores, i: scores[:, i, :],
            score,
            words=words,
            least=keep - keep // 6,
            most=keep,
            guess=guess,
            active=active,
            patience=patience,
        )
        # Without a threshold within the limits a lower one serves, unless too many nodes touch the box.
        bounded = found.complete | (found.value > 0)
        hit = selected(score, jnp.where(in_order, reach, jnp.where(bounded, found.value, found.above)))
        column = columns(hit, width)
        column = jnp.where(jnp.arange(width, dtype=jnp.int32)[None, :] < keep, column, -1)
        at = jnp.arange(child.shape[0], dtype=jnp.int32)[:, None] * child.shape[1] + jnp.maximum(column, 0)
        node = jnp.where(column >= 0, child.reshape(-1).at[at].get(mode="promise_in_bounds"), -1)
        count = jnp.sum(lax.population_count(hit), axis=1, dtype=jnp.uint32).astype(jnp.int32)
        left = (jnp.max(node, axis=1) + 1) * span[level]
        resume = jnp.where(in_order & (count > keep), jnp.minimum(near.resume, left), near.resume)
        # The scores are finished before they are counted and chosen from (`apart`): computed anew, a tie just above the
        # threshold could come below it. Where there is no room for all, nothing is promised.
        bound = jnp.minimum(near.bound, jnp.where(bounded & (count <= keep), found.value, 0.0))
        return Near(node, jnp.where(in_order, near.bound, bound), resume)

    return lax.fori_loop(levels[0], levels[1], down, varying_like(near, tree, boxes, reach, start))


def _gaps(
    nodes: Boxes, period: Float[Array, " a"] | None, at: Int[Array, "b c"], boxes: Boxes, beyond: Float[Array, " b"]
) -> Float[Array, "b c"]:
    """Squared distance from each box to the nodes at the given places; inf where there is none or none beyond a distance."""
    total = jnp.where(at < 0, jnp.inf, jnp.zeros(at.shape, dtype=jnp.float32))
    for axis in range(len(nodes.lower)):
        low, high = (side[axis].at[jnp.maximum(at, 0)].get(mode="promise_in_bounds") for side in nodes)
        own_low, own_high = (side[axis][:, None] for side in boxes)
        total = total + jnp.square(gap(low, high, own_low, own_high, None if period is None else period[axis]))
    return jnp.where((total <= LARGEST) & (total > beyond[:, None]), total, jnp.inf)
