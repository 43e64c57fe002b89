"""Samples of a cloud: points spread evenly over it, and points out of the balls around given places."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.brute import map_blocks, square_distances
from cablejax.ops.neighbors.index import RadiusResult, count_status, differentiable, tree_of
from cablejax.ops.neighbors.request import bit, prepare
from cablejax.ops.neighbors.select import WORD, columns, selected
from cablejax.ops.varying import varying_like
from cablejax.types import Status

CHUNK = 32 * WORD  # points looked at in one step
PAIRS = 1 << 20  # and pairs of a query and a point


class Sample(NamedTuple):
    """Points chosen one after the other.

    Attributes:
        rows: Their rows in the order of choice `[count]` int32; -1 where no point was left.
        sq_dist: Squared distance of each from the nearest chosen before it `[count]`: it only falls, and no point of the
            cloud lies farther from the sample than the last; inf for the first and where no point was left. No gradient.
        status: `Status` bits `[]` int32: TOO_FEW_NEIGHBORS where there are fewer points than wanted, EMPTY, NOT_FINITE,
            and INVALID for a start that is no point.
    """

    rows: Int[Array, " count"]
    sq_dist: Float[Array, " count"]
    status: Int[Array, ""]


@partial(jax.jit, static_argnames=("count",))
def farthest_point_sampling(
    xyz: Float[Array, "n c"],
    *,
    count: int,
    mask: Bool[Array, " n"] | None = None,
    start: int | Int[Array, ""] | None = None,
) -> Sample:
    """Choose points that lie far from each other: each is the farthest from those chosen before, of equal ones the first.

    No row is chosen twice, duplicates come last. It takes `count` passes over the cloud (Eldar et al. 1997; Qi et al.
    2017, PointNet++).

    Args:
        xyz: Points `[n, c]`, any unit.
        count: Points to choose. Static.
        mask: True where a row is a point `[n]`; all if None.
        start: Row of the first; the first point if None.

    Returns:
        Rows, how far each lay from the sample before it, and status.

    Raises:
        ValueError: If `count` is below 1, the shapes do not fit together, or coordinates are float64 or integers.

    Example:
        >>> sample = farthest_point_sampling(jnp.array([[0.0], [1.0], [5.0], [9.0]]), count=3)
        >>> sample.rows.tolist(), sample.sq_dist.tolist()
        ([0, 3, 2], [inf, 81.0, 16.0])
    """
    if count < 1:
        raise ValueError(f"count: expected at least 1, got {count}")
    if start is not None and jnp.ndim(start) > 0:
        raise ValueError(f"start: expected one row, got shape {list(jnp.shape(start))}")
    points = prepare(xyz, mask)
    usable, axes = points.usable(), points.xyz.T
    number = jnp.arange(xyz.shape[0], dtype=jnp.int32)
    first = jnp.int32(-1) if start is None else jnp.asarray(start, dtype=jnp.int32)
    good = jnp.bool_(True) if start is None else jnp.any(usable & (number == first))
    nearest = jnp.where(usable & good, jnp.inf, -1.0).astype(jnp.float32)

    def choose(i: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        nearest, rows, sq_dist = state
        # Two passes that vectorise, where an argmax does not; the least row of those that are equally far.
        farthest = jnp.max(nearest)
        row = jnp.min(jnp.where(nearest == farthest, number, number.shape[0]))
        row = jnp.where((i == 0) & (first >= 0) & good, first, row)
        left = farthest >= 0
        square = jnp.square(axes - axes[:, row][:, None]).sum(axis=0)
        after = jnp.where(number == row, -1.0, jnp.where(nearest >= 0, jnp.minimum(nearest, square), -1.0))
        rows = rows.at[i].set(jnp.where(left, row, -1))
        return after, rows, sq_dist.at[i].set(jnp.where(left, farthest, jnp.inf))

    none = (jnp.full(count, -1, dtype=jnp.int32), jnp.full(count, jnp.inf, dtype=jnp.float32))
    _, rows, sq_dist = lax.fori_loop(
        jnp.int32(0), jnp.int32(count), choose, varying_like((nearest, *none), axes, usable, first)
    )
    bits = {
        Status.TOO_FEW_NEIGHBORS: good & (rows[-1] < 0),
        Status.EMPTY: ~jnp.any(usable),
        Status.NOT_FINITE: jnp.any(points.asked & ~points.finite),
        Status.INVALID: ~good,
    }
    return Sample(rows, sq_dist, sum((bit(true, name) for name, true in bits.items()), jnp.int32(0)))


@partial(jax.jit, static_argnames=("capacity",))
def ball_query(
    xyz: Float[Array, "n c"],
    queries: Float[Array, "q c"],
    *,
    radius: float | Float[Array, ""],
    capacity: int,
    mask: Bool[Array, " n"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> RadiusResult:
    """The first points, by row, within a radius of each query: a sample of the ball that does not crowd at its centre.

    The grouping of PointNet++ (Qi et al. 2017), where `radius_search` keeps the nearest. Rows in random order make it a
    random sample. All pairs are compared, q times n.

    Args:
        xyz: Points `[n, c]`, any unit.
        queries: Centres of the balls `[q, c]`; a point at the centre counts.
        radius: In the unit of `xyz`, the boundary included; one that is negative or NaN leaves `Status.INVALID`.
        capacity: Points kept per ball. Static.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        box: Lengths of a periodic box, see `build_tree` `[c]`; open space if None.

    Returns:
        Rows in ascending order, squared distances, counts (also beyond `capacity`) and status per query.

    Raises:
        ValueError: If `capacity` is below 1, the shapes do not fit together, or coordinates are float64 or integers.

    Example:
        >>> ball_query(jnp.array([[0.9], [5.0], [0.1], [0.2]]), jnp.array([[0.0]]), radius=1.0, capacity=2).neighbors.tolist()
        [[0, 2]]
    """
    if capacity < 1:
        raise ValueError(f"capacity: expected at least 1, got {capacity}")
    tree = tree_of(xyz, mask, None, box, with_tree=False)
    points, asking = tree.points(), tree.asking(queries, None, radius)
    usable = points.usable() if asking.good is None else points.usable() & asking.good
    square_radius = jnp.square(jnp.asarray(radius, dtype=jnp.float32))
    steps = -(-xyz.shape[0] // CHUNK)
    spare = (0, steps * CHUNK - xyz.shape[0])
    chunks = jnp.pad(points.xyz, (spare, (0, 0))).reshape(steps, CHUNK, -1)
    there = jnp.pad(usable, spare).reshape(steps, CHUNK)
    slot = jnp.arange(capacity, dtype=jnp.int32)[None, :]

    def look(block: Float[Array, "b c"]) -> tuple[Array, Array, Array]:
        def step(i: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            rows, sq_dist, count = state
            key = square_distances(block, chunks[i], points.box)
            key = jnp.where(there[i][None, :], key, jnp.inf)
            words = selected(key.reshape(block.shape[0], -1, WORD), jnp.broadcast_to(square_radius, block.shape[:1]))
            new = columns(words, capacity)
            at = slot - count[:, None]
            column = jnp.take_along_axis(new, jnp.clip(at, 0, capacity - 1), axis=1)
            fresh = (at >= 0) & (column >= 0)
            found = jnp.take_along_axis(key, jnp.maximum(column, 0), axis=1)
            count = count + jnp.sum(lax.population_count(words), axis=1, dtype=jnp.uint32).astype(jnp.int32)
            return jnp.where(fresh, column + i * CHUNK, rows), jnp.where(fresh, found, sq_dist), count

        b = block.shape[0]
        nothing = (jnp.full((b, capacity), -1, jnp.int32), jnp.full((b, capacity), jnp.inf, jnp.float32))
        state = varying_like((*nothing, jnp.zeros(b, jnp.int32)), block, chunks, there, square_radius)
        return lax.fori_loop(jnp.int32(0), jnp.int32(steps), step, state)

    rows, sq_dist, count = map_blocks(look, queries.shape[0], CHUNK, asking.xyz, elements=PAIRS)
    asked = asking.usable()
    rows = jnp.where(asked[:, None], rows, -1)
    sq_dist = differentiable(jnp.where(asked[:, None], sq_dist, jnp.inf), rows, tree, queries)
    count = jnp.where(asked, count, 0)
    return RadiusResult(rows, sq_dist, count, count_status(asking, count, capacity))
