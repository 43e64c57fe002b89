"""Neighbours by measuring every pair, a block of queries at a time: the exact base case and the last fall back."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.metric import shorter_way

BLOCK_ELEMENTS = 1 << 22  # pairs measured at once: 16 MiB of float32


def square_distances(
    queries: Float[Array, "q c"], xyz: Float[Array, "n c"], box: Float[Array, " c"] | None = None
) -> Float[Array, "q n"]:
    """Squared distances by differences, which keep their digits far from the origin (|x|^2 - 2xy + |y|^2 does not).

    In a periodic box, with all coordinates between 0 and its lengths, the shorter way around counts.
    """
    total = jnp.zeros((queries.shape[0], xyz.shape[0]), dtype=xyz.dtype)
    for axis in range(xyz.shape[1]):
        difference = queries[:, axis, None] - xyz[None, :, axis]
        total = total + jnp.square(shorter_way(difference, None if box is None else box[axis]))
    return total


def map_blocks(function, n: int, m: int, *arrays: Array, elements: int = BLOCK_ELEMENTS):
    """Apply `function` to blocks of rows of `arrays` (leading axis n), so that `[block, m]` has no more than `elements`."""
    block = max(1, min(n, elements // max(m, 1)))
    if block >= n:
        return function(*arrays)
    blocks = -(-n // block)
    padded = [jnp.pad(a, [(0, blocks * block - n)] + [(0, 0)] * (a.ndim - 1)) for a in arrays]
    out = lax.map(lambda rows: function(*rows), tuple(a.reshape(blocks, block, *a.shape[1:]) for a in padded))
    return jax.tree.map(lambda a: a.reshape(blocks * block, *a.shape[2:])[:n], out)


def knn_brute(
    queries: Float[Array, "q c"],
    xyz: Float[Array, "n c"],
    valid: Bool[Array, " n"],
    skip: Int[Array, " q"],
    *,
    k: int,
    box: Float[Array, " c"] | None = None,
) -> tuple[Int[Array, "q k"], Float[Array, "q k"]]:
    """The k nearest valid points of each query but `skip`, nearest first, ties by row; -1 and inf where none."""
    n = xyz.shape[0]
    taken = min(k, n)

    def nearest(block_queries: Array, block_skip: Array) -> tuple[Array, Array]:
        distance = square_distances(block_queries, xyz, box)
        usable = valid[None, :] & (jnp.arange(n, dtype=jnp.int32)[None, :] != block_skip[:, None])
        negative, index = lax.top_k(-jnp.where(usable, distance, jnp.inf), taken)
        return jnp.where(negative > -jnp.inf, index, -1), -negative

    index, distance = map_blocks(nearest, queries.shape[0], n, queries, skip)
    pad = ((0, 0), (0, k - taken))
    return jnp.pad(index, pad, constant_values=-1), jnp.pad(distance, pad, constant_values=jnp.inf)


def count_brute(
    queries: Float[Array, "q c"],
    xyz: Float[Array, "n c"],
    valid: Bool[Array, " n"],
    skip: Int[Array, " q"],
    square_radius: Float[Array, ""],
    *,
    box: Float[Array, " c"] | None = None,
) -> Int[Array, " q"]:
    """How many valid points but `skip` lie within the radius, the boundary included."""

    def inside(block_queries: Array, block_skip: Array) -> Array:
        near = square_distances(block_queries, xyz, box) <= square_radius
        usable = valid[None, :] & (jnp.arange(xyz.shape[0], dtype=jnp.int32)[None, :] != block_skip[:, None])
        return jnp.sum(near & usable, axis=1, dtype=jnp.int32)

    return map_blocks(inside, queries.shape[0], xyz.shape[0], queries, skip)
