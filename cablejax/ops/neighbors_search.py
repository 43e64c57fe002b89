"""Exact search over a tree: blocks of 16 queries share their candidate leaves, and every row is proven or searched again.

1. Down the tree, each node keeps the nearest nodes of its level: a leaf of queries ends with `share` candidate leaves
   and a bound on the distance of every leaf left out.
2. Each query takes a threshold that admits a little more than k candidates, measures those again, and ranks them.
3. A row is proven if its k-th distance is below its threshold and below the bound. Rows that are not go down the tree
   on their own, with what they found as their reach; the few still unproven are compared with every point.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors_select import LARGEST, WORD, columns, narrow, selected
from cablejax.ops.neighbors_tree import LEAF, Boxes, Tree

NODES = 24  # nodes kept per node on the way down
CHUNK = 4096  # leaves searched at once, which bounds memory
RETRY = 512  # unproven rows searched at once
SURE = 1.0 - 1e-6  # above the rounding of one squared distance measured in two ways


class Ranked(NamedTuple):
    """Candidates of each query, unordered, with their rank.

    Attributes:
        row: Row of each candidate in the cloud `[q, s]` int32, -1 where there is none.
        sq_dist: Squared distance `[q, s]`, inf where there is none.
        rank: Place in the order by distance, then row `[q, s]` int32; unique among candidates.
    """

    row: Int[Array, "q s"]
    sq_dist: Float[Array, "q s"]
    rank: Int[Array, "q s"]


def slots_for(k: int) -> int:
    """Candidates measured exactly for k neighbours: room for the point itself, near ties, and a quick threshold."""
    return -(-(k + 9 + k // 8) // 4) * 4


def share_for(k: int) -> int:
    """Candidate leaves per leaf of queries: what a disc of k points overlaps on a surface, half as many again, and even."""
    side = LEAF**0.5
    disc = (2.0 * side + 2.0 * ((k + 1) / 3.1416) ** 0.5) ** 2 / LEAF
    return 2 * int(0.6 * disc + 4)


def search(
    tree: Tree,
    targets: Tree,
    skip: Bool[Array, ""] | bool,
    *,
    k: int,
    finish: Callable[[Ranked], tuple[Array, ...]],
) -> tuple[Array, ...]:
    """Find the k nearest points of `tree` for each point of `targets`, and let `finish` make rows of output of them.

    Args:
        tree: The points searched.
        targets: The queries, of the same depth; holes get rows of output without meaning.
        skip: Whether a query's own row is left out.
        k: Neighbours per query. Static.
        finish: Makes arrays with leading axis q from ranked candidates of q queries.

    Returns:
        What `finish` makes, one row per place of `targets` `[leaves * 16, ...]`.
    """
    wanted = min(k + 1, tree.row.size)
    share = min(share_for(k), tree.row.shape[0] + tree.row.shape[0] % 2)
    near, bound = _descend(tree, targets.levels[:-1])
    split = targets.row.shape[0] // near.shape[0]

    def block(first: Array, parents: int) -> tuple[tuple, Array, Array]:
        """Search the leaves below `parents` consecutive nodes."""
        cut = lambda a, axis, size: lax.dynamic_slice_in_dim(a, first * (size // parents), size, axis)  # noqa: E731
        leaves = parents * split
        boxes = Boxes(*(cut(side, 1, leaves) for side in targets.levels[-1]))
        leaf, limit, _ = _children(
            tree, len(tree.levels) - 1, cut(near, 0, parents), cut(bound, 0, parents), boxes, share, None
        )
        xyz, row = cut(targets.xyz, 1, leaves), cut(targets.row, 0, leaves)
        area = jnp.sort(jnp.where(boxes.upper > boxes.lower, boxes.upper - boxes.lower, 0.0), axis=0)
        guess = jnp.maximum(area[2] * area[1] * (wanted / (3.1416 * LEAF)), area[2] ** 2 * 1e-3)
        reach = jnp.full(row.shape, LARGEST)
        return _rank(tree, xyz, row, leaf, limit, guess[:, None] + jnp.zeros_like(reach), reach, skip, k, finish)

    outputs, proven, reach = _chunked(block, near.shape[0], split)
    proven = proven | (targets.row.reshape(-1) < 0)
    outputs, proven, reach = _again(tree, targets, skip, k, finish, outputs, proven, reach)
    return _compare_all(tree, targets, skip, k, finish, outputs, proven)


def _descend(tree: Tree, target_levels: tuple[Boxes, ...]) -> tuple[Array, Array]:
    """Nodes near each node of the level above the leaves, and a bound on the squared distance of all others."""
    near, bound = jnp.zeros((1, 1), dtype=jnp.int32), jnp.full((1,), LARGEST)
    for level, boxes in enumerate(target_levels):
        near, bound, _ = _children(tree, level, near, bound, boxes, NODES, None)
    return near, bound


def _children(
    tree: Tree, level: int, near: Array, bound: Array, boxes: Boxes, most: int, reach: Array | None
) -> tuple[Array, Array, Array]:
    """From the nodes near each parent to at most `most` of their children near each box; -1 where there are fewer."""
    lower, upper = tree.levels[level]
    split = lower.shape[1] // (tree.levels[level - 1].lower.shape[1] if level else 1)
    count = boxes.lower.shape[1]
    child = jnp.where(near[..., None] >= 0, near[..., None] * split + jnp.arange(split), -1).reshape(near.shape[0], -1)
    child = jnp.pad(child, ((0, 0), (0, -child.shape[1] % WORD)), constant_values=-1)
    times = count // near.shape[0]
    limit = jnp.repeat(bound, times)
    shape = (near.shape[0], times, child.shape[1])
    gap = jnp.zeros(shape)
    for axis in range(3):
        low, high = lower[axis][child][:, None, :], upper[axis][child][:, None, :]
        own = (boxes.lower[axis].reshape(-1, times, 1), boxes.upper[axis].reshape(-1, times, 1))
        gap = gap + jnp.square(jnp.maximum(0.0, jnp.maximum(low - own[1], own[0] - high)))
    missing = (child < 0)[:, None, :] | ~(gap <= LARGEST)
    score = jnp.where(missing, jnp.inf, gap).reshape(count, -1, WORD)
    cap = jnp.full(count, LARGEST) if reach is None else reach
    guess = jnp.where(cap < LARGEST, cap * 0.5, jnp.maximum(1e-30, jnp.max(_sides(boxes), axis=0) ** 2))
    most = min(most, child.shape[1])
    found = narrow(lambda s: s, score, least=most - most // 6, most=most, guess=guess, cap=cap)
    picked = columns(selected(score, found.value), most)
    owner = jnp.repeat(jnp.arange(near.shape[0]), times)[:, None]
    kept = jnp.where(picked >= 0, child[owner, jnp.maximum(picked, 0)], -1)
    return kept, jnp.minimum(limit, jnp.where(found.complete, found.value, 0.0)), found.complete


def _sides(boxes: Boxes) -> Array:
    """Side lengths `[3, nodes]`, zero for empty boxes."""
    return jnp.where(boxes.upper > boxes.lower, boxes.upper - boxes.lower, 0.0)


def _rank(
    tree: Tree,
    xyz: Float[Array, "3 b q"],
    row: Int[Array, "b q"],
    leaf: Int[Array, "b m"],
    bound: Float[Array, " b"],
    guess: Float[Array, "b q"],
    reach: Float[Array, "b q"],
    skip: Bool[Array, ""] | bool,
    k: int,
    finish: Callable[[Ranked], tuple[Array, ...]],
) -> tuple[tuple[Array, ...], Array, Array]:
    """Rank the candidates of b blocks of q queries; say which rows are proven and how far each need look."""
    blocks = row.shape[0]
    slots = slots_for(k)
    at = jnp.maximum(leaf, 0)
    there = (tree.row[at] >= 0) & (leaf >= 0)[..., None]
    near = jnp.where(there, tree.xyz[:, at], jnp.inf).reshape(3, blocks, -1, WORD)

    def score(queries: Array) -> Array:
        difference = queries[:, :, :, None, None] - near[:, :, None]
        return jnp.square(difference[0]) + jnp.square(difference[1]) + jnp.square(difference[2])

    found = narrow(score, xyz, least=min(k + 1, near.shape[2] * WORD), most=slots, guess=guess, cap=reach)
    column = columns(selected(score(xyz), found.value), slots)
    candidate = jnp.take_along_axis(leaf, jnp.maximum(column, 0).reshape(blocks, -1) // LEAF, axis=1)
    candidate = candidate.reshape(column.shape) * LEAF + jnp.maximum(column, 0) % LEAF
    other = tree.row.reshape(-1)[candidate]
    real = (column >= 0) & ~(skip & (other == row[..., None]))
    points = tree.xyz.reshape(3, -1)[:, candidate]
    difference = xyz[..., None] - points
    distance = jnp.square(difference[0]) + jnp.square(difference[1]) + jnp.square(difference[2])
    ranked = rank(jnp.where(real, other, -1).reshape(-1, slots), jnp.where(real, distance, jnp.inf).reshape(-1, slots))
    last = jnp.min(jnp.where(ranked.rank == k - 1, ranked.sq_dist, jnp.inf), axis=1).reshape(row.shape)
    everything = found.value >= LARGEST
    inside = found.complete & ((last <= found.value * SURE) | everything)
    proven = inside & ((last < bound[:, None] * SURE) | (bound[:, None] >= LARGEST))
    return finish(ranked), proven.reshape(-1), jnp.minimum(last, LARGEST).reshape(-1)


def rank(row: Int[Array, "q s"], sq_dist: Float[Array, "q s"]) -> Ranked:
    """Order candidates by distance, then row, by counting those that come before; faster than sorting short rows."""
    bits = lax.bitcast_convert_type(sq_dist, jnp.int32)  # ordered as the floats, none of which is negative
    lower_row = (row[:, None, :] < row[:, :, None]).astype(jnp.int32)
    before = (bits[:, None, :] - bits[:, :, None] - lower_row) < 0
    return Ranked(row, sq_dist, jnp.sum(before, axis=2, dtype=jnp.int32))


def in_order(ranked: Ranked, k: int) -> tuple[Int[Array, "q k"], Float[Array, "q k"]]:
    """The k first candidates in order of rank: rows, -1 where there are fewer, and squared distances, inf there."""
    place = (ranked.rank[:, None, :] == jnp.arange(k)[:, None]) & (ranked.row >= 0)[:, None, :]
    row = jnp.sum(jnp.where(place, ranked.row[:, None, :] + 1, 0), axis=2) - 1
    bits = lax.bitcast_convert_type(
        ranked.sq_dist, jnp.int32
    )  # whole numbers add up in any order: XLA vectorises the sum
    sq_dist = lax.bitcast_convert_type(jnp.sum(jnp.where(place, bits[:, None, :], 0), axis=2), jnp.float32)
    return row, jnp.where(row >= 0, sq_dist, jnp.inf)


def _chunked(block: Callable, parents: int, split: int) -> tuple:
    """Run `block` over all parents, a chunk of leaves at a time where there are many."""
    step = max(1, CHUNK // split)
    if parents <= step:
        return block(jnp.int32(0), parents)

    def write(i: Array, buffers: tuple) -> tuple:
        first = jnp.minimum(i * step, parents - step)
        size = step * split * LEAF
        start = first * (split * LEAF)
        return jax.tree.map(
            lambda all_, part: lax.dynamic_update_slice_in_dim(all_, part, start, 0),
            buffers,
            jax.tree.map(lambda part: part.reshape(size, *part.shape[1:]), block(first, step)),
        )

    shapes = jax.eval_shape(lambda: block(jnp.int32(0), step))
    empty = jax.tree.map(lambda s: jnp.zeros((parents * split * LEAF, *s.shape[1:]), s.dtype), shapes)
    return lax.fori_loop(0, -(-parents // step), write, empty)


def _unproven(proven: Array, size: int) -> tuple[Array, Array]:
    """Places of unproven rows, in chunks of `size`, filled with places out of range; and how many chunks."""
    n = proven.shape[0]
    place = jnp.nonzero(~proven, size=-(-n // size) * size, fill_value=n)[0].astype(jnp.int32)
    return place, -(-jnp.sum(~proven) // size)


def _again(tree, targets, skip, k, finish, outputs, proven, reach):
    """Search unproven rows one by one down the tree, no further than what they found already."""
    places, chunks = _unproven(proven, RETRY)
    xyz, row = targets.xyz.reshape(3, -1), targets.row.reshape(-1)

    def once(state: tuple) -> tuple:
        i, outputs, proven, reach = state
        place = lax.dynamic_slice_in_dim(places, i * RETRY, RETRY)
        at = jnp.minimum(place, row.shape[0] - 1)
        own, own_reach = xyz[:, at], reach[at]
        limit = jnp.where(own_reach < LARGEST, own_reach * (2.0 - SURE * SURE), LARGEST)
        near = jnp.zeros((RETRY, 1), dtype=jnp.int32)
        bound = jnp.full(RETRY, LARGEST)
        for level in range(len(tree.levels)):
            most = 64 if level + 1 == len(tree.levels) else 48
            near, bound, _ = _children(tree, level, near, bound, Boxes(own, own), most, limit)
        near = jnp.pad(near, ((0, 0), (0, near.shape[1] % 2)), constant_values=-1)
        guess = jnp.where(own_reach < LARGEST, own_reach, 1.0)
        result, sure, new_reach = _rank(
            tree, own[:, :, None], row[at][:, None], near, bound, guess[:, None], limit[:, None], skip, k, finish
        )
        outputs = jax.tree.map(lambda o, r: o.at[place].set(r, mode="drop"), outputs, result)
        return i + 1, outputs, proven.at[place].set(sure, mode="drop"), reach.at[place].min(new_reach, mode="drop")

    return lax.while_loop(lambda s: s[0] < chunks, once, (jnp.int32(0), outputs, proven, reach))[1:]


def _compare_all(tree, targets, skip, k, finish, outputs, proven):
    """Compare the rows that are still unproven with every point, by row number, so that top-k breaks ties."""
    size = 64
    places, chunks = _unproven(proven, size)
    rows = tree.row.reshape(-1)
    taken = min(slots_for(k), rows.shape[0])
    order = jnp.argsort(jnp.where(rows < 0, rows.shape[0], rows))
    points, sorted_rows = tree.xyz.reshape(3, -1)[:, order], rows[order]
    xyz, row = targets.xyz.reshape(3, -1), targets.row.reshape(-1)

    def once(state: tuple) -> tuple:
        i, outputs = state
        place = lax.dynamic_slice_in_dim(places, i * size, size)
        at = jnp.minimum(place, row.shape[0] - 1)
        difference = xyz[:, at][:, :, None] - points[:, None, :]
        distance = jnp.square(difference[0]) + jnp.square(difference[1]) + jnp.square(difference[2])
        usable = (sorted_rows >= 0) & ~(skip & (sorted_rows == row[at][:, None]))
        negative, column = lax.top_k(-jnp.where(usable, distance, jnp.inf), taken)
        result = finish(rank(jnp.where(negative > -jnp.inf, sorted_rows[column], -1), -negative))
        return i + 1, jax.tree.map(lambda o, r: o.at[place].set(r, mode="drop"), outputs, result)

    return lax.while_loop(lambda s: s[0] < chunks, once, (jnp.int32(0), outputs))[1]
