"""Exact search over a tree by one loop: blocks of 8 queries share their candidate leaves, and every query is proven.

A pool takes a round at a time, and whoever is done makes room for the next in the queue:

0. First groups of eight blocks go down the tree, to the nodes one level above the leaves that are nearest to them.
1. Then the blocks take part. In every round a block looks at the few leaves that are nearest to it and that it has not
   seen, among those below the nodes of its group. A query whose k-th neighbour is nearer than every leaf left out is
   proven, as most are after one round.
2. The queries that a few rounds do not serve, and the strays, queue up again one by one. Each goes down the tree on its own
   to the leaves nearest to it. If that proves nothing it knows how far its k neighbours reach, and looks at all leaves
   within that reach in their order, a handful a round, until none is left. So nothing is compared with every point.

All three phases are turns of one loop over one body, as a program costs by its length before it is of any use.
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
from cablejax.ops.neighbors.tree import FIRST, LEAF, SPLIT, Boxes, Tree, true_places
from cablejax.ops.varying import varying_like

POOL = 256  # groups, blocks or queries searched at once: what they carry stays in the cache, and few wait for the last
SURE = 1.0 - 1e-6  # below this share of a bound, rounding does not matter
HASTE = 16  # one group or block in so many may meet fewer leaves than it could
SLOW = 256  # one query in so many may be left to be searched alone where its threshold takes long to find
FEW = 32  # neighbours up to which more leaves are looked at
ROUNDS = 6  # of a block, before its queries are searched one by one
GROUPS, BLOCKS, ALONE = range(3)  # phases

Finish = Callable[[Ranked], tuple[Array, ...]]


class _Pool(NamedTuple):
    """Groups, blocks or single queries at work.

    Attributes:
        number: Which of them, in the numbering of the phase `[b]`.
        place: Places of the queries among the targets `[b, 8]`; those of a group are not looked at.
        there: Where there are queries `[b, 8]`.
        todo: Queries that are not proven `[b, 8]`.
        round: Rounds done `[b]`.
        start: First leaf to look at, for a query alone, from the second round on `[b]`.
        beyond: Squared distance up to which a block has seen all leaves `[b]`.
        reach: Squared distance within which k points lie `[b, 8]`; LARGEST where fewer are known.
        row: Rows of the candidates found so far `[b * 8, s]`, -1 for none.
        sq_dist: Their squared distances.
    """

    number: Int[Array, " b"]
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
        phase: GROUPS, BLOCKS or ALONE.
        queue: Numbers of the groups or blocks, or places, still to be searched `[places]`.
        waiting: The first of the queue that has not been taken, and the number in it.
        pool: Those at work.
        groups: Nodes one level above the leaves near each group, as far as they are known `[groups]`.
        proven: Places that are done `[places]`.
        outputs: What is returned.
    """

    phase: Int[Array, ""]
    queue: Int[Array, " places"]
    waiting: tuple[Int[Array, ""], Int[Array, ""]]
    pool: _Pool
    groups: Near
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
    boxes, pool = _group_boxes(targets), min(POOL, targets.row.shape[0])
    xyz, rows = targets.xyz.reshape(len(targets.xyz), -1), targets.row.reshape(-1)

    def busy(state: _State) -> Array:
        (first, count), at_work = state.waiting, jnp.any(state.pool.todo, axis=1)
        # The last few blocks would keep an almost empty pool going: they are searched alone as well.
        enough = jnp.where(state.phase == BLOCKS, pool // 8, 0)
        return (first < count) | (jnp.sum(at_work, dtype=jnp.int32) > enough)

    def once(state: _State) -> _State:
        state = _refill(targets, state)
        pool = state.pool
        group = jax.tree.map(lambda each: each[pool.place[:, 0] // (LEAF * SPLIT)], state.groups)
        own = _Own(xyz[:, pool.place], rows[pool.place], state.phase, Boxes(*(side[:, pool.number] for side in boxes)))
        near = _down(tree, pool, own, group, share_for(k))

        def keep(pool: _Pool) -> tuple[_Pool, Ranked, Array]:
            nobody = jnp.zeros_like(pool.todo)
            return varying_like((pool._replace(todo=nobody), _nothing(nobody.size, k), nobody), state)

        def look(pool: _Pool) -> tuple[_Pool, Ranked, Array]:
            return varying_like(_round(tree, pool, own, near, group.bound, include_self=include_self, k=k), state)

        after, ranked, proven = lax.cond(state.phase == GROUPS, keep, look, pool)
        known = jnp.where((state.phase == GROUPS) & pool.todo[:, 0], pool.number, boxes.lower.shape[1])
        groups = jax.tree.map(lambda old, new: old.at[known].set(new, mode="drop"), state.groups, near)
        put = jnp.where(proven, own.row, queries).reshape(-1)
        outputs = tuple(
            old.at[put].set(new, mode="drop") for old, new in zip(state.outputs, finish(ranked), strict=True)
        )
        done = jnp.where(proven, pool.place, state.proven.size).reshape(-1)
        proven = state.proven.at[done].set(True, mode="drop")
        return state._replace(pool=after, groups=groups, proven=proven, outputs=outputs)

    shapes = jax.eval_shape(lambda: finish(_nothing(1, k)))
    outputs = tuple(jnp.zeros((queries, *s.shape[1:]), s.dtype) for s in shapes)
    none = jnp.zeros((pool, LEAF), jnp.int32)
    far, nothing = jnp.full(none.shape, LARGEST, dtype=jnp.float32), _nothing(pool * LEAF, k)
    beyond = jnp.full(pool, -1.0, dtype=jnp.float32)
    zeros = none[:, 0]
    idle = _Pool(zeros, none, none > 0, none > 0, zeros, zeros, beyond, far, nothing.row, nothing.sq_dist)
    proven, empty = rows < 0, (jnp.int32(0), jnp.int32(0))
    groups = root(tree, boxes.lower.shape[1], _width(k))
    first = _State(jnp.int32(-1), jnp.zeros(proven.size, jnp.int32), empty, idle, groups, proven, outputs)

    def phase(turn: Array, state: _State) -> _State:
        return lax.while_loop(busy, once, _line_up(targets, state))

    return lax.fori_loop(0, 3, phase, varying_like(first, tree, targets)).outputs


def share_for(k: int) -> int:
    """Leaves per block and round, a multiple of four: those that its queries' neighbourhoods meet on a surface, and more.

    A scan is no even sheet: its lines are denser along than across, and its noise has depth. With a third more, one block
    in four of a noisy scan was searched twice, and the search took a third longer; so there are nine tenths more, and more
    still for few neighbours, where a leaf more costs little: k = 20 on a terrestrial scan then takes 135 ms for 154.
    """
    across = 2.0 * LEAF**0.5 + 2.0 * ((k + 1) / 3.1416) ** 0.5
    return 4 * round((2.2 if k <= FEW else 1.9) * across**2 / LEAF / 4)


def _width(k: int) -> int:
    """Nodes kept of the levels above the leaves."""
    return max(FIRST, share_for(k))


def _group_boxes(targets: Tree) -> Boxes:
    """The boxes of the groups of eight leaves."""
    leaves = targets.row.shape[0]
    spare = ((0, 0), (0, -leaves % SPLIT))
    lower, upper = (
        jnp.pad(side[:, -leaves:], spare, constant_values=edge).reshape(len(side), -1, SPLIT)
        for side, edge in zip(targets.boxes, (jnp.inf, -jnp.inf), strict=True)
    )
    return Boxes(lower.min(axis=2), upper.max(axis=2))


def _line_up(targets: Tree, state: _State) -> _State:
    """Who is searched next: the groups, then blocks without strays, then all queries that are left, one by one."""
    left, phase = ~state.proven, state.phase + 1
    number = jnp.arange(left.size, dtype=jnp.int32)
    by_block = jnp.any(left.reshape(-1, LEAF), axis=1)
    by_block = jnp.pad(by_block, (0, left.size - by_block.size)) & (number < targets.first_stray_leaf())
    by_group = number < state.groups.bound.size
    wanted = jnp.where(phase == GROUPS, by_group, jnp.where(phase == BLOCKS, by_block, left))
    idle = state.pool._replace(todo=jnp.zeros_like(state.pool.todo))
    waiting = (jnp.zeros_like(phase), jnp.sum(wanted, dtype=jnp.int32))
    return state._replace(phase=phase, queue=true_places(wanted), pool=idle, waiting=waiting)


def _refill(targets: Tree, state: _State) -> _State:
    """Give the places of those who are done to the next in the queue."""
    pool, (first, count) = state.pool, state.waiting
    idle = ~jnp.any(pool.todo, axis=1)
    at = first + jnp.cumsum(idle, dtype=jnp.int32) - 1
    number = state.queue.at[at].get(mode="clip")
    lane = jnp.arange(LEAF, dtype=jnp.int32)[None, :]
    grouped, alone = state.phase == GROUPS, state.phase == ALONE
    place = number[:, None] * jnp.where(alone, 1, LEAF) + jnp.where(alone, 0, lane)
    place = jnp.where(grouped, 0, place)
    there = (at < count)[:, None] & ((state.phase == BLOCKS) | (lane == 0))
    there &= grouped | (targets.row.reshape(-1)[place] >= 0)
    new = idle[:, None]
    fresh = pool._replace(
        number=jnp.where(idle, number, pool.number),
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


class _Own(NamedTuple):
    """What those at work are themselves.

    Attributes:
        xyz: Coordinates of the queries `[a, b, 8]`.
        row: Their rows `[b, 8]`.
        phase: GROUPS, BLOCKS or ALONE.
        group: Boxes of the groups at work `[a, b]`.
    """

    xyz: Float[Array, "a b 8"]
    row: Int[Array, "b 8"]
    phase: Int[Array, ""]
    group: Boxes

    def boxes(self, pool: _Pool) -> Boxes:
        """Boxes of those at work; empty where nobody is.

        A block's stays that of all its queries, proven or not: were it smaller, a leaf that was seen would not lie below
        `beyond`.
        """
        at_work = jnp.any(pool.todo, axis=1)
        there = (pool.there & at_work[:, None])[None]
        lower, upper = (
            fold(jnp.where(there, self.xyz, nowhere), axis=2)
            for fold, nowhere in ((jnp.min, jnp.inf), (jnp.max, -jnp.inf))
        )
        grouped = at_work & (self.phase == GROUPS)
        return Boxes(jnp.where(grouped, self.group.lower, lower), jnp.where(grouped, self.group.upper, upper))

    def in_order(self, pool: _Pool) -> Bool[Array, " b"]:
        """Who looks at leaves in their order."""
        return (self.phase == ALONE) & (pool.round > 0)


def _down(tree: Tree, pool: _Pool, own: _Own, group: Near, share: int) -> Near:
    """Groups go down to the nodes above the leaves, blocks from there to the leaves, queries alone all the way."""
    (b, width), leaves = group.node.shape, len(tree.level_sizes()) - 1
    blocks, top = own.phase == BLOCKS, root(tree, b, width)
    above = jax.tree.map(lambda known, top: jnp.where(blocks, known, top), group, top)
    levels = (jnp.where(blocks, leaves - 1, 0), jnp.where(own.phase == GROUPS, leaves - 1, leaves))
    reach = jnp.max(jnp.where(pool.todo, pool.reach, 0.0), axis=1)
    reach = jnp.where(reach < LARGEST, reach * 1.00001, LARGEST)  # rounding cannot make it too short
    return descend(
        tree,
        above,
        own.boxes(pool),
        levels=levels,
        most=share,
        in_order=own.in_order(pool),
        reach=reach,
        start=pool.start,
        beyond=pool.beyond,
        # A query alone that meets few leaves at first has to look at all leaves of a wide reach.
        patience=jnp.where(own.phase == ALONE, 0, b // HASTE),
    )


def _round(
    tree: Tree,
    pool: _Pool,
    own: _Own,
    near: Near,
    known: Float[Array, " b"],
    *,
    include_self: bool,
    k: int,
) -> tuple[_Pool, Ranked, Bool[Array, "b 8"]]:
    """One round of all blocks: their candidates, and the queries that it proved.

    The leaves near them are in `near`, and their groups know all leaves nearer than `known`, squared.
    """
    blocks, alone, in_order = pool.place.shape[0], own.phase == ALONE, own.in_order(pool)
    sure = jnp.all(pool.round >= 0)
    fresh = pool.round <= alone.astype(jnp.int32)
    old = jnp.where(jnp.repeat(fresh, LEAF)[:, None], jnp.inf, pool.sq_dist)
    skip = jnp.full_like(own.row, -1) if include_self else own.row
    candidates = gather(tree, near.node[:, : share_for(k)], pool.row, old, own.xyz, skip, sure)
    guess = jnp.where(pool.reach < LARGEST, pool.reach, _expected(own.boxes(pool), k)[:, None])
    guess = jnp.maximum(guess, 1e-30)
    patience = jnp.where(alone, 0, blocks * LEAF // SLOW)
    ranked, last, answered = choose(candidates, guess, k=k, active=pool.todo, patience=patience, sure=sure)
    last, bound = last.reshape(blocks, LEAF), near.bound[:, None]
    nearest = (last < bound * SURE) | (bound >= LARGEST)
    proven = answered & pool.todo & jnp.where(in_order[:, None], (near.resume >= tree.row.shape[0])[:, None], nearest)
    todo = pool.todo & answered & ~proven  # who got no answer is searched alone
    reach = jnp.where(pool.todo, jnp.minimum(pool.reach, last), pool.reach)
    # A block is given up, and its queries searched alone, where it has seen all leaves that its group knows.
    far = near.bound >= known
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


def _expected(boxes: Boxes, k: int) -> Float[Array, " b"]:
    """Squared radius of the disc that holds k points if the queries of a box fill its two long sides."""
    x, y, z = boxes.sides()
    longest = jnp.maximum(jnp.maximum(x, y), z)
    area = jnp.maximum(jnp.maximum(jnp.maximum(x * y, x * z), y * z), 0.05 * jnp.square(longest))
    return area * np.float32(1.8 * (k + 1) / (3.1416 * LEAF))
