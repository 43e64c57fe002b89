"""From the root of a tree to the nodes near each of many boxes, with a bound on the distance of all the others."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from cablejax.ops.neighbors_select import LARGEST, WORD, columns, narrow, selected
from cablejax.ops.neighbors_tree import Boxes, Tree

NODES = 24  # nodes kept per node on the way down


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
    many: bool = False,
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
        many: Whether there are so many boxes that counting pays off against `top_k`. Static.

    Returns:
        Children within reach, at most `most` for each box.
    """
    above = 1 if from_root or level == 0 else tree.levels[level - 1].lower.shape[1]
    split = tree.levels[level].lower.shape[1] // above
    parents, times = near.node.shape[0], reach.shape[0] // near.node.shape[0]
    child = near.node[:, :, None] * split + jnp.arange(split)[None, None, :]
    child = jnp.where(near.node[:, :, None] >= 0, child, -1).reshape(parents, -1)
    child = jnp.pad(child, ((0, 0), (0, -child.shape[1] % WORD)), constant_values=-1)
    score = _gaps(tree.levels[level], child, boxes, times)
    score = jnp.where(score <= reach[:, None], score, jnp.inf)
    most = min(most, child.shape[1] - 1)
    picked, bound = (_nearest_by_counting if many else _nearest_by_sorting)(score, boxes, most)
    owner = jnp.repeat(jnp.arange(parents), times)[:, None]
    node = jnp.where(picked >= 0, child.at[owner, jnp.maximum(picked, 0)].get(mode="promise_in_bounds"), -1)
    bound = jnp.where(bound < LARGEST, bound, jnp.where(reach < LARGEST, reach, LARGEST))
    return Near(node, jnp.minimum(jnp.repeat(near.bound, times), bound))


def _nearest_by_sorting(score: Float[Array, "b c"], boxes: Boxes, most: int) -> tuple[Array, Array]:
    """Columns of the smallest scores, -1 where there are fewer, and the smallest score left out."""
    del boxes
    negative, column = lax.top_k(-score, most + 1)
    column = jnp.where(negative > -jnp.inf, column, -1)
    return column[:, :most], jnp.minimum(-negative[:, most], LARGEST)


def _nearest_by_counting(score: Float[Array, "b c"], boxes: Boxes, most: int) -> tuple[Array, Array]:
    """The same from a threshold: a few less than `most` columns, and the threshold."""
    score = score.reshape(score.shape[0], -1, WORD)
    cap = jnp.full(score.shape[0], LARGEST)
    guess = jnp.maximum(1e-30, jnp.square(jnp.max(boxes.sides(), axis=0)))
    active = boxes.upper[0] >= boxes.lower[0]
    found = narrow(lambda s: s, score, least=most - most // 6, most=most, guess=guess, cap=cap, active=active)
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
