"""Exact search over a tree by one loop: blocks of 8 queries share their candidate leaves, and every query is proven.

A pool of blocks takes a round at a time, and whoever is done makes room for the next in the queue:

1. First the blocks take part. In every round a block looks at the few leaves that are nearest to it and that it has not
   seen, among those near the group of eight blocks to which it belongs. A query whose k-th neighbour is nearer than every
   leaf left out is proven, as most are after one round.
2. The queries that a few rounds do not serve, and the strays, queue up again one by one. Each goes down the tree on its own
   to the leaves nearest to it. If that proves nothing it knows how far its k neighbours reach, and looks at all leaves
   within that reach in their order, a handful a round, until none is left. So nothing is compared with every point.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.descent import Near, descend, root
from cablejax.ops.neighbors.rank import Ranked, choose, gather, rank, slots_for
from cablejax.ops.neighbors.select import LARGEST
from cablejax.ops.neighbors.tree import FIRST, LEAF, SPLIT, Boxes, Tree
from cablejax.ops.varying import varying_like

POOL = 512  # blocks searched at once: their candidates stay in the cache
SURE = 1.0 - 1e-6  # below this share of a bound, rounding does not matter
SLOW = 256  # one query in so many may be left to be searched alone where its threshold takes long to find
FEW = 32  # neighbours up to which more leaves are looked at
ROUNDS = 6  # of a block, before its queries are searched one by one

Finish = Callable[[Ranked], tuple[Array, ...]]


class _Pool(NamedTuple):
    """Blocks at work.

    Attributes:
        place: Places of the queries among the targets `[b, 8]`.
        there: Where there are queries `[b, 8]`.
        todo: Queries that are not proven `[b, 8]`.
        round: Rounds done `[b]`.
        start: First leaf to look at, for a query alone, from the second round on `[b]`.
        beyond: Squared distance up to which a block has seen all leaves `[b]`.
        reach: Squared distance within which k points lie `[b, 8]`; LARGEST where fewer are known.
        row: Rows of the candidates found so far `[b * 8, s]`, -1 for none.
        sq_dist: Their squared distances.
    """

    place: Int[Array, "b 8"]
    there: Bool[Array, "b 8"]
    todo: Bool[Array, "b 8"]
    round: Int[Array, " b"]
    start: Int[Array, " b"]
    beyond: Float[Array, " b"]
    reach: Float[Array, "b 8"]
    row: Int[Array, "q s"]
    sq_dist: Float[Array, "q s"]


class _State(NamedTuple):
    """What the loop carries.

    Attributes:
        alone: Whether queries are searched one by one.
        queue: Blocks, or places, still to be searched `[places]`.
        waiting: The first of the queue that has not been taken, and the number in it.
        pool: Blocks at work.
        proven: Places that are done `[places]`.
        outputs: What is returned.
    """

    alone: Bool[Array, ""]
    queue: Int[Array, " places"]
    waiting: tuple[Int[Array, ""], Int[Array, ""]]
    pool: _Pool
    proven: Bool[Array, " places"]
    outputs: tuple[Array, ...]


def search(tree: Tree, targets: Tree, queries: int, *, k: int, include_self: bool, finish: Finish) -> tuple[Array, ...]:
    """Find the k nearest points for each point of `targets`, and let `finish` make rows of output of them.

    Args:
        tree: The points searched.
        targets: The queries as a tree.
        queries: Rows of output. Static.
        k: Neighbours per query. Static.
        include_self: Whether a query finds its own row. Static.
        finish: Makes arrays with leading axis q from the ranked candidates of q queries.

    Returns:
        What `finish` makes, in the order of the queries' rows `[queries, ...]`; zeros for rows that are not in `targets`.
    """
    groups = _near_groups(tree, targets, max(FIRST, share_for(k)))
    pool = min(POOL, targets.row.shape[0])

    def busy(state: _State) -> Array:
        (first, count), at_work = state.waiting, jnp.any(state.pool.todo, axis=1)
        # The last few blocks would keep an almost empty pool going: they are searched alone as well.
        enough = jnp.where(state.alone, 0, pool // 8)
        return (first < count) | (jnp.sum(at_work, dtype=jnp.int32) > enough)

    def once(state: _State) -> _State:
        state = _refill(targets, state)
        before = state.pool.todo
        xyz = targets.xyz.reshape(len(targets.xyz), -1)[:, state.pool.place]
        row = targets.row.reshape(-1)[state.pool.place]
        own = jnp.full_like(row, -1) if include_self else row
        pool, ranked, proven = _round(tree, state.pool, xyz, own, state.alone, groups, k)
        put = jnp.where(proven, row, queries).reshape(-1)
        outputs = tuple(
            old.at[put].set(new, mode="drop") for old, new in zip(state.outputs, finish(ranked), strict=True)
        )
        done = jnp.where(before & proven, state.pool.place, state.proven.size).reshape(-1)
        return state._replace(pool=pool, proven=state.proven.at[done].set(True, mode="drop"), outputs=outputs)

    shapes = jax.eval_shape(lambda: finish(_nothing(1, k)))
    outputs = tuple(jnp.zeros((queries, *s.shape[1:]), s.dtype) for s in shapes)
    none = jnp.zeros((pool, LEAF), jnp.int32)
    far, nothing = jnp.full(none.shape, LARGEST, dtype=jnp.float32), _nothing(pool * LEAF, k)
    beyond = jnp.full(pool, -1.0, dtype=jnp.float32)
    idle = _Pool(none, none > 0, none > 0, none[:, 0], none[:, 0], beyond, far, nothing.row, nothing.sq_dist)
    proven = targets.row.reshape(-1) < 0
    empty = (jnp.int32(0), jnp.int32(0))
    first = _State(jnp.bool_(True), jnp.zeros(proven.size, jnp.int32), empty, idle, proven, outputs)

    def both(turn: Array, state: _State) -> _State:
        return lax.while_loop(busy, once, _line_up(targets, state))

    return lax.fori_loop(0, 2, both, varying_like(first, tree, targets)).outputs


def share_for(k: int) -> int:
    """Leaves per block and round, a multiple of four: those that its queries' neighbourhoods meet on a surface, and more.

    A scan is no even sheet: its lines are denser along than across, and its noise has depth. With a third more, one block
    in four of a noisy scan was searched twice, and the search took a third longer; so there are nine tenths more, and more
    still for few neighbours, where a leaf more costs little: k = 20 on a terrestrial scan then takes 135 ms for 154.
    """
    across = 2.0 * LEAF**0.5 + 2.0 * ((k + 1) / 3.1416) ** 0.5
    return 4 * round((2.2 if k <= FEW else 1.9) * across**2 / LEAF / 4)


def _near_groups(tree: Tree, targets: Tree, width: int) -> Near:
    """The nodes one level above the leaves that are near each group of eight leaves of targets."""
    blocks = targets.row.shape[0]
    groups = -(-blocks // SPLIT)
    spare = ((0, 0), (0, groups * SPLIT - blocks))
    lower, upper = (
        jnp.pad(side[:, -blocks:], spare, constant_values=edge).reshape(-1, groups, SPLIT)
        for side, edge in zip(targets.boxes, (jnp.inf, -jnp.inf), strict=True)
    )
    return _above_leaves(tree, Boxes(lower.min(axis=2), upper.max(axis=2)), width)


def _above_leaves(tree: Tree, boxes: Boxes, width: int, **how: Array) -> Near:
    """Nodes one level above the leaves, nearest first unless told how."""
    b = boxes.lower.shape[1]
    nearest = {
        "in_order": jnp.zeros(b, bool),
        "reach": jnp.full(b, LARGEST, dtype=jnp.float32),
        "start": jnp.zeros(b, jnp.int32),
    }
    levels = (0, len(tree.level_sizes()) - 2)
    return descend(tree, root(tree, b, width), boxes, levels=levels, most=width, **(how or nearest))


def _line_up(targets: Tree, state: _State) -> _State:
    """Who is searched next: first blocks without strays, then all queries that are left, one by one."""
    left = ~state.proven
    by_block = jnp.any(left.reshape(-1, LEAF), axis=1)
    by_block &= jnp.arange(by_block.size, dtype=jnp.int32) < targets.first_stray_leaf()
    alone = ~state.alone
    wanted = jnp.where(alone, left, jnp.pad(by_block, (0, left.size - by_block.size)))
    queue = jnp.nonzero(wanted, size=left.size, fill_value=0)[0].astype(jnp.int32)
    idle = state.pool._replace(todo=jnp.zeros_like(state.pool.todo))
    return state._replace(
        alone=alone, queue=queue, pool=idle, waiting=(jnp.zeros_like(queue[0]), jnp.sum(wanted, dtype=jnp.int32))
    )


def _refill(targets: Tree, state: _State) -> _State:
    """Give the places of idle blocks to the next in the queue."""
    pool, (first, count) = state.pool, state.waiting
    idle = ~jnp.any(pool.todo, axis=1)
    at = first + jnp.cumsum(idle, dtype=jnp.int32) - 1
    number = state.queue.at[at].get(mode="clip")
    lane = jnp.arange(LEAF, dtype=jnp.int32)[None, :]
    place = jnp.where(state.alone, number[:, None], number[:, None] * LEAF + lane)
    there = (at < count)[:, None] & (~state.alone | (lane == 0)) & (targets.row.reshape(-1)[place] >= 0)
    new = idle[:, None]
    fresh = pool._replace(
        place=jnp.where(new, place, pool.place),
        there=jnp.where(new, there, pool.there),
        todo=jnp.where(new, there, pool.todo),
        round=jnp.where(idle, 0, pool.round),
        start=jnp.where(idle, 0, pool.start),
        beyond=jnp.where(idle, -1.0, pool.beyond),
        reach=jnp.where(new, LARGEST, pool.reach),
    )
    taken = jnp.minimum(first + jnp.sum(idle, dtype=jnp.int32), count)
    return state._replace(pool=fresh, waiting=(taken, count))


def _round(
    tree: Tree, pool: _Pool, xyz: Float[Array, "a b 8"], own: Int[Array, "b 8"], alone: Array, groups: Near, k: int
) -> tuple[_Pool, Ranked, Bool[Array, "b 8"]]:
    """One round of all blocks: their candidates, and the queries that it proved."""
    blocks, width, share = pool.place.shape[0], groups.node.shape[1], share_for(k)
    # The box stays that of all queries, proven or not: were it smaller, a leaf that was seen would not lie below `beyond`.
    boxes = _box(xyz, pool.there & jnp.any(pool.todo, axis=1, keepdims=True))
    in_order = alone & (pool.round > 0)
    reach = jnp.max(jnp.where(pool.todo, pool.reach, 0.0), axis=1)
    reach = jnp.where(reach < LARGEST, reach * 1.00001, LARGEST)  # rounding cannot make it too short
    how = {"in_order": in_order, "reach": reach, "start": pool.start}
    above = lax.cond(
        alone,
        lambda: _above_leaves(tree, boxes, width, **how),
        lambda: jax.tree.map(lambda each: each[pool.place[:, 0] // (LEAF * SPLIT)], groups),
    )
    levels = (len(tree.level_sizes()) - 2, len(tree.level_sizes()) - 1)
    near = descend(tree, above, boxes, levels=levels, most=share, beyond=pool.beyond, **how)
    sure = jnp.all(pool.round >= 0)
    fresh = pool.round <= alone.astype(jnp.int32)
    old = jnp.where(jnp.repeat(fresh, LEAF)[:, None], jnp.inf, pool.sq_dist)
    candidates = gather(tree, near.node[:, :share], pool.row, old, xyz, own, sure)
    guess = jnp.where(pool.reach < LARGEST, pool.reach, _expected(boxes, k)[:, None])
    guess = jnp.maximum(guess, 1e-30)
    patience = jnp.where(alone, 0, blocks * LEAF // SLOW)
    ranked, last, answered = choose(candidates, guess, k=k, active=pool.todo, patience=patience, sure=sure)
    last, bound = last.reshape(blocks, LEAF), near.bound[:, None]
    nearest = (last < bound * SURE) | (bound >= LARGEST)
    proven = answered & pool.todo & jnp.where(in_order[:, None], (near.resume >= tree.row.shape[0])[:, None], nearest)
    todo = pool.todo & answered & ~proven  # who got no answer is searched alone
    reach = jnp.where(pool.todo, jnp.minimum(pool.reach, last), pool.reach)
    # A block is given up, and its queries searched alone, where it has seen all leaves that its group knows.
    far = near.bound >= above.bound
    given_up = ~alone & (far | (near.bound <= 0.0) | (pool.round >= ROUNDS))
    start = jnp.where(in_order, near.resume, 0)
    after = pool._replace(
        todo=todo & ~given_up[:, None],
        round=pool.round + 1,
        start=start,
        beyond=near.bound,
        reach=reach,
        row=ranked.row,
        sq_dist=ranked.sq_dist,
    )
    return after, ranked, proven


def _nothing(q: int, k: int) -> Ranked:
    """No candidates."""
    shape = (q, slots_for(k))
    return rank(jnp.full(shape, -1, dtype=jnp.int32), jnp.full(shape, jnp.inf, dtype=jnp.float32))


def _box(xyz: Float[Array, "a b 8"], there: Bool[Array, "b 8"]) -> Boxes:
    """Boxes of the queries that are there."""
    lower = jnp.min(jnp.where(there[None], xyz, jnp.inf), axis=2)
    return Boxes(lower, jnp.max(jnp.where(there[None], xyz, -jnp.inf), axis=2))


def _expected(boxes: Boxes, k: int) -> Float[Array, " b"]:
    """Squared radius of the disc that holds k points if the queries of a box fill its two long sides."""
    x, y, z = boxes.sides()
    longest = jnp.maximum(jnp.maximum(x, y), z)
    area = jnp.maximum(jnp.maximum(jnp.maximum(x * y, x * z), y * z), 0.05 * jnp.square(longest))
    return area * np.float32(1.8 * (k + 1) / (3.1416 * LEAF))
