"""From the root of a tree to the nodes near each of many boxes, with a bound on the distance of all the others."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cablejax.ops.neighbors_select import LARGEST, WORD, columns, narrow, selected
from cablejax.ops.neighbors_tree import Boxes, Tree

NODES = 32  # nodes kept per node on the way down


class Near(NamedTuple):
    """Nodes of one level near each of b boxes.

    Attributes:
        node: Node numbers `[b, m]` int32, -1 where there are fewer.
        bound: No point outside these nodes is nearer to a point of the box `[b]`, squared; LARGEST where none is left out.
    """

    node: Int[Array, "b m"]
    bound: Float[Array, " b"]


def descend(tree: Tree, target_levels: tuple[Boxes, ...]) -> Near:
    """Nodes near each target node of the last level given; targets and tree go down together."""
    near = everything(1)
    for level, boxes in enumerate(target_levels):
        reach = jnp.full(boxes.lower.shape[1], LARGEST)
        near = children(tree, level, near, boxes, reach, most=NODES)
    return near


def everything(b: int) -> Near:
    """The root, from which nothing is left out."""
    return Near(jnp.zeros((b, 1), dtype=jnp.int32), jnp.full((b,), LARGEST))


def children(
    tree: Tree,
    level: int,
    near: Near,
    boxes: Boxes,
    reach: Float[Array, " b"],
    *,
    most: int,
    from_root: bool = False,
) -> Near:
    """From the nodes near each parent to the nearest of their children for each of its boxes.

    Args:
        tree: The points searched.
        level: Level of the children. Static.
        near: Nodes of the level above, near each parent `[p, m]`.
        boxes: The parents' boxes `[3, p * t]`, t for each, consecutive.
        reach: Squared distance beyond which nothing is wanted `[p * t]`; LARGEST for no limit.
        most: Children kept. Static.
        from_root: Whether `near` is the root and all nodes of the level are its children. Static.

    Returns:
        Children within reach, at most `most` for each box: all of them, or up to a sixth fewer than `most`.
    """
    above = 1 if from_root or level == 0 else tree.levels[level - 1].lower.shape[1]
    split = tree.levels[level].lower.shape[1] // above
    parents, times = near.node.shape[0], reach.shape[0] // near.node.shape[0]
    child = near.node[:, :, None] * split + jnp.arange(split)[None, None, :]
    child = jnp.where(near.node[:, :, None] >= 0, child, -1).reshape(parents, -1)
    child = jnp.pad(child, ((0, 0), (0, -child.shape[1] % WORD)), constant_values=-1)
    score = _gaps(tree.levels[level], child, boxes, times)
    score = jnp.where(score <= reach[:, None], score, jnp.inf)
    picked, bound = _nearest(score, boxes, min(most, child.shape[1]))
    owner = jnp.repeat(jnp.arange(parents), times)[:, None]
    node = jnp.where(picked >= 0, child.at[owner, jnp.maximum(picked, 0)].get(mode="promise_in_bounds"), -1)
    bound = jnp.where(bound < LARGEST, bound, jnp.where(reach < LARGEST, reach, LARGEST))
    return Near(node, jnp.minimum(jnp.repeat(near.bound, times), bound))


def _nearest(score: Float[Array, "b c"], boxes: Boxes, most: int) -> tuple[Array, Array]:
    """Columns of the smallest scores, -1 where there are fewer, and a bound below all that are left out."""
    score = score.reshape(score.shape[0], -1, WORD)
    guess = jnp.maximum(1e-30, jnp.square(jnp.max(boxes.sides(), axis=0)))
    active = boxes.upper[0] >= boxes.lower[0]

    def word(scores: Array, i: int) -> Array:
        return scores[:, i, :]

    least, words = most - most // 6, score.shape[1]
    found = narrow(word, score, words=words, least=least, most=most, guess=guess, active=active)
    return columns(selected(score, found.value), most), jnp.where(found.complete, found.value, 0.0)


def _gaps(level: Boxes, child: Int[Array, "p c"], boxes: Boxes, times: int) -> Float[Array, "b c"]:
    """Squared distance from each box to each of its parent's candidate children; inf where there is no box."""
    total = jnp.where(child < 0, jnp.inf, 0.0)[:, None, :]
    at = jnp.maximum(child, 0)
    for axis in range(3):
        low = level.lower[axis].at[at].get(mode="promise_in_bounds")[:, None, :]
        high = level.upper[axis].at[at].get(mode="promise_in_bounds")[:, None, :]
        own_low, own_high = (side[axis].reshape(-1, times, 1) for side in boxes)
        total = total + jnp.square(jnp.maximum(0.0, jnp.maximum(low - own_high, own_low - high)))
    return jnp.where(total <= LARGEST, total, jnp.inf).reshape(child.shape[0] * times, -1)
