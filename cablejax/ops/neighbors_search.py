"""Exact search over a tree: blocks of 8 queries share their candidate leaves, and every row is proven or searched again.

1. Down the tree, each node keeps the nearest nodes of its level: a leaf of queries ends with a few candidate leaves and a
   bound on the distance of every leaf left out.
2. Each query takes a threshold that admits a little more than k candidates, measures those again, and ranks them.
3. A row is proven if its k-th distance is below its threshold and below the bound. Blocks with rows that are not look at
   more leaves, no further than what they found; then such rows go down the tree on their own; the few still unproven are
   compared with every point.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors_brute import square_distances
from cablejax.ops.neighbors_descent import Near, children, descend, everything
from cablejax.ops.neighbors_rank import Ranked, Verdict, rank, rank_blocks, slots_for
from cablejax.ops.neighbors_select import LARGEST, WORD, apart
from cablejax.ops.neighbors_tree import LEAF, Boxes, Tree

CHUNK = 1024  # leaves searched at once, which bounds memory and keeps their candidates in the cache
WIDE_BLOCKS, WIDER = 128, 20  # unproven blocks searched at once, and how many more leaves each looks at
RETRY = 256  # unproven rows searched at once
RETRY_ROOTS = 1024  # the widest level that such a row compares with whole
RETRY_NODES, RETRY_LEAVES = 32, 64  # nodes and leaves that such a row looks at
ALONE = 8  # rows compared with every point at once: their distances are the largest array there is

Finish = Callable[[Ranked], tuple[Array, ...]]


def search(
    xyz: Float[Array, "n 3"], tree: Tree, targets: Tree, *, k: int, include_self: bool, finish: Finish
) -> tuple[Array, ...]:
    """Find the k nearest points for each point of `targets`, and let `finish` make rows of output of them.

    Args:
        xyz: The points searched.
        tree: The same points as a tree.
        targets: The queries as a tree of the same depth; holes get rows of output without meaning.
        k: Neighbours per query. Static.
        include_self: Whether a query finds its own row. Static.
        finish: Makes arrays with leading axis q from the ranked candidates of q queries.

    Returns:
        What `finish` makes, one row per place of `targets` `[leaves * 8, ...]`.
    """
    near = descend(tree, targets.levels[:-1])
    outputs, verdict = _by_blocks(tree, targets, near, k, include_self, finish)
    outputs, verdict = _by_wide_blocks(tree, targets, near, k, include_self, finish, outputs, verdict)
    outputs, verdict = _by_rows(tree, targets, k, include_self, finish, outputs, verdict)
    return _by_all(xyz, tree, targets, k, include_self, finish, outputs, verdict)


def share_for(k: int) -> int:
    """Leaves per block, a multiple of four: those that the neighbourhoods of its queries meet on a surface, nine tenths more.

    A scan is no even sheet: its lines are denser along than across, and its noise has depth. With a third more, one block
    in four of a noisy scan was searched twice, and the search took a third longer.
    """
    across = 2.0 * LEAF**0.5 + 2.0 * ((k + 1) / 3.1416) ** 0.5
    return 4 * round(1.9 * across**2 / LEAF / 4)


def _own(targets: Tree, include_self: bool) -> Int[Array, "leaves 8"]:
    """The row that each query must not find: none is -1, and -2 marks holes."""
    return jnp.where(targets.row < 0, -2, -1 if include_self else targets.row)


def _by_blocks(tree: Tree, targets: Tree, near: Near, k: int, include_self: bool, finish: Finish) -> tuple:
    """Search leaf by leaf of the targets."""
    own = _own(targets, include_self)
    split = own.shape[0] // near.node.shape[0]
    share = share_for(k)

    def below(first: Array, parents: int) -> tuple:
        """Search the leaves below some consecutive parents."""

        def cut(array: Array, axis: int, each: int) -> Array:
            return lax.dynamic_slice_in_dim(array, first * each, parents * each, axis)

        boxes = Boxes(*(cut(side, 1, split) for side in targets.levels[-1]))
        rows = cut(own, 0, split)
        reach = jnp.full(rows.shape[0], LARGEST)
        above = Near(cut(near.node, 0, 1), cut(near.bound, 0, 1))
        leaves = _in_words(children(tree, len(tree.levels) - 1, above, boxes, reach, most=share))
        guess = jnp.broadcast_to(_expected(boxes, k)[:, None], rows.shape)
        ranked, verdict = rank_blocks(tree, cut(targets.xyz, 1, split), rows, leaves, guess, k=k)
        return finish(ranked), verdict

    return in_chunks(below, near.node.shape[0], split)


def _in_words(near: Near) -> Near:
    """A number of leaves that fills whole words of candidates."""
    spare = -near.node.shape[1] % (WORD // LEAF)
    return Near(jnp.pad(near.node, ((0, 0), (0, spare)), constant_values=-1), near.bound)


def _expected(boxes: Boxes, k: int) -> Float[Array, " b"]:
    """Squared radius of the disc that holds k points if the leaf's points fill the two long sides of its box."""
    sides = jnp.sort(boxes.sides(), axis=0)
    area = jnp.maximum(sides[2] * sides[1], 0.05 * jnp.square(sides[2]))
    return jnp.maximum(1e-30, area * (1.8 * (k + 1) / (3.1416 * LEAF)))


def _by_wide_blocks(
    tree: Tree, targets: Tree, near: Near, k: int, include_self: bool, finish: Finish, outputs, verdict: Verdict
) -> tuple:
    """Search again the leaves of targets with unproven rows, among more leaves, no further than what they found."""
    own, split = _own(targets, include_self), targets.row.shape[0] // near.node.shape[0]
    blocks, most = own.shape[0], share_for(k) + WIDER
    places, chunks = unproven(verdict.proven.reshape(blocks, LEAF).all(axis=1), WIDE_BLOCKS)

    def once(state: tuple) -> tuple:
        i, outputs, verdict = state
        place = lax.dynamic_slice_in_dim(places, i * WIDE_BLOCKS, WIDE_BLOCKS)
        at = jnp.minimum(place, blocks - 1)
        boxes = Boxes(targets.levels[-1].lower[:, at], targets.levels[-1].upper[:, at])
        rows = jnp.where((place < blocks)[:, None], own[at], -2)
        known = jnp.where(rows > -2, verdict.reach.reshape(blocks, LEAF)[at], 0.0)
        above = Near(near.node[at // split], near.bound[at // split])
        leaves = children(tree, len(tree.levels) - 1, above, boxes, _slightly_more(known.max(axis=1)), most=most)
        guess = jnp.where(known < LARGEST, jnp.maximum(known, 1e-30), _expected(boxes, k)[:, None])
        ranked, sure = rank_blocks(tree, targets.xyz[:, at], rows, _in_words(leaves), guess, k=k)
        # Rows proven before keep their answer.
        put = (at[:, None] * LEAF + jnp.arange(LEAF)[None, :]).reshape(-1)
        put = jnp.where(verdict.proven[put] | (rows.reshape(-1) == -2), blocks * LEAF, put)
        outputs, verdict = _put((outputs, verdict), put, (finish(ranked), sure))
        return i + 1, outputs, verdict

    _, outputs, verdict = lax.while_loop(lambda s: s[0] < chunks, once, (jnp.int32(0), outputs, verdict))
    return outputs, verdict


def _slightly_more(reach: Array) -> Array:
    """A reach that rounding cannot make too short."""
    return jnp.where(reach < LARGEST, reach * 1.00001, LARGEST)


def in_chunks(below: Callable, parents: int, split: int) -> tuple:
    """Run `below` over all parents, a chunk of leaves at a time where there are many."""
    step = max(1, CHUNK // split)
    if parents <= step + step // 2:
        return below(jnp.int32(0), parents)
    each = split * LEAF
    shapes = jax.eval_shape(lambda: below(jnp.int32(0), step))
    buffers = jax.tree.map(lambda s: jnp.zeros((parents * each, *s.shape[1:]), s.dtype), shapes)

    def write(i: Array, buffers: tuple) -> tuple:
        first = jnp.minimum(i * step, parents - step)  # the last chunk overlaps the one before
        parts = below(first, step)
        return jax.tree.map(lambda b, p: lax.dynamic_update_slice_in_dim(b, p, first * each, 0), buffers, parts)

    return lax.fori_loop(0, -(-parents // step), write, buffers)


def unproven(proven: Bool[Array, " n"], size: int) -> tuple[Array, Array]:
    """Places of unproven rows, padded to whole chunks with a place out of range; and how many chunks they fill."""
    n = proven.shape[0]
    place = jnp.nonzero(~proven, size=-(-n // size) * size, fill_value=n)[0].astype(jnp.int32)
    return place, -(-jnp.sum(~proven) // size)


def _put(old: tuple, place: Array, new: tuple) -> tuple:
    """Replace rows; places out of range are dropped."""
    return jax.tree.map(lambda o, r: o.at[place].set(r, mode="drop"), old, new)


def _by_rows(tree: Tree, targets: Tree, k: int, include_self: bool, finish: Finish, outputs, verdict: Verdict) -> tuple:
    """Search unproven rows one by one down the tree, no further than what they found already."""
    places, chunks = unproven(verdict.proven, RETRY)
    xyz, own = targets.xyz.reshape(3, -1), _own(targets, include_self).reshape(-1)
    last = len(tree.levels) - 1
    first = max([0, *(i for i in range(last) if tree.levels[i].lower.shape[1] <= RETRY_ROOTS)])

    def down(query: Array, found: Array) -> Near:
        reach, boxes, near = _slightly_more(found), Boxes(query, query), everything(1)
        for level in range(first, last + 1):
            most = RETRY_LEAVES if level == last else RETRY_NODES
            near = children(tree, level, near, boxes, reach, most=most, from_root=level == first)
        return _in_words(near)

    def once(state: tuple) -> tuple:
        i, outputs, verdict = state
        place = lax.dynamic_slice_in_dim(places, i * RETRY, RETRY)
        at = jnp.minimum(place, own.shape[0] - 1)
        query, found = xyz[:, at], verdict.reach[at]
        near = apart(down, i < chunks, query, found)
        guess = jnp.where(found < LARGEST, jnp.maximum(found, 1e-30), 1.0)[:, None]
        rows = jnp.where(place < own.shape[0], own[at], -2)[:, None]
        ranked, sure = rank_blocks(tree, query[:, :, None], rows, near, guess, k=k)
        outputs, verdict = _put((outputs, verdict), place, (finish(ranked), sure))
        return i + 1, outputs, verdict

    _, outputs, verdict = lax.while_loop(lambda s: s[0] < chunks, once, (jnp.int32(0), outputs, verdict))
    return outputs, verdict


def _by_all(xyz, tree: Tree, targets: Tree, k: int, include_self: bool, finish: Finish, outputs, verdict: Verdict):
    """Compare the rows that are still unproven with every point; top-k breaks ties by row."""
    places, chunks = unproven(verdict.proven, ALONE)
    n = xyz.shape[0]
    valid = jnp.zeros(n, dtype=bool).at[jnp.where(tree.row < 0, n, tree.row).reshape(-1)].set(True, mode="drop")
    queries, own = targets.xyz.reshape(3, -1), _own(targets, include_self).reshape(-1)

    def once(state: tuple) -> tuple:
        i, outputs = state
        place = lax.dynamic_slice_in_dim(places, i * ALONE, ALONE)
        at = jnp.minimum(place, own.shape[0] - 1)
        distance = square_distances(queries[:, at].T, xyz)
        usable = valid[None, :] & (jnp.arange(n)[None, :] != own[at][:, None])
        negative, row = lax.top_k(-jnp.where(usable, distance, jnp.inf), min(slots_for(k), n))
        row = jnp.pad(
            jnp.where(negative > -jnp.inf, row, -1), ((0, 0), (0, slots_for(k) - row.shape[1])), constant_values=-1
        )
        sq_dist = jnp.pad(-negative, ((0, 0), (0, slots_for(k) - negative.shape[1])), constant_values=jnp.inf)
        return i + 1, _put(outputs, place, finish(rank(row, sq_dist)))

    return lax.while_loop(lambda s: s[0] < chunks, once, (jnp.int32(0), outputs))[1]
