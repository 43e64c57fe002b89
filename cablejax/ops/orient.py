"""Normals whose signs agree along a surface: a least spanning tree of the neighbour graph hands them on."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.varying import varying_like


@jax.jit
def orient_normals(
    xyz: Float[Array, "n 3"], normals: Float[Array, "n 3"], neighbors: Int[Array, "n k"]
) -> Float[Array, "n 3"]:
    """Flip normals so that they agree with their neighbours', each connected piece for itself (Hoppe et al. 1992, 3.3).

    Signs go along the least spanning tree of the neighbour graph, an edge weighing the more the less parallel its two
    normals are, so that they are handed over sharp edges last. The highest point of each piece, by the third coordinate,
    gets a normal that points up. All pieces grow at once (Boruvka 1926): some log2 n rounds over the edges.

    Args:
        xyz: Points `[n, 3]`, any unit.
        normals: Of `estimate_normals` `[n, 3]`; where they are zero they stay so, and hand nothing on.
        neighbors: Of `knn` `[n, k]`, -1 where there is none.

    Returns:
        Normals `[n, 3]`.

    Raises:
        ValueError: If the rows do not agree in number.
    """
    n, k = neighbors.shape
    if xyz.shape != (n, 3) or normals.shape != (n, 3):
        raise ValueError(f"xyz, normals: expected [{n}, 3] as neighbors has {n} rows, got {xyz.shape}, {normals.shape}")
    known = jnp.any(normals != 0, axis=1)
    other = jnp.maximum(neighbors, 0).reshape(-1)
    own = jnp.repeat(jnp.arange(n, dtype=jnp.int32), k)
    cosine = jnp.sum(normals[own] * normals[other], axis=1)
    real = (neighbors >= 0).reshape(-1) & known[own] & known[other]
    weight = jnp.where(real, jnp.maximum(1.0 - jnp.abs(cosine), 0.0), jnp.inf)
    edges = _Edges(own, other, weight, jnp.where(cosine < 0, -1, 1).astype(jnp.int32))
    start = _Pieces(jnp.arange(n, dtype=jnp.int32), jnp.ones(n, dtype=jnp.int32), jnp.bool_(True))
    pieces = lax.while_loop(lambda pieces: pieces.grew, lambda pieces: _join(edges, pieces), varying_like(start, edges))
    height = jnp.where(known, xyz[:, 2], -jnp.inf)
    top = jax.ops.segment_max(height, pieces.piece, num_segments=n)
    rows = jnp.arange(n, dtype=jnp.int32)
    highest = jax.ops.segment_min(jnp.where(height == top[pieces.piece], rows, n), pieces.piece, num_segments=n)
    highest = jnp.minimum(highest, n - 1)[pieces.piece]
    down = normals[highest, 2] * pieces.sign[highest] < 0
    return normals * jnp.where(down, -pieces.sign, pieces.sign).astype(normals.dtype)[:, None]


class _Edges(NamedTuple):
    """Edges of the graph `[e]`: their ends, weight (inf for none), and whether the normals at the ends agree (1 or -1)."""

    own: Int[Array, " e"]
    other: Int[Array, " e"]
    weight: Float[Array, " e"]
    agree: Int[Array, " e"]


class _Pieces(NamedTuple):
    """The piece of each point, named by one of its points, its sign within the piece `[n]`, and whether any grew."""

    piece: Int[Array, " n"]
    sign: Int[Array, " n"]
    grew: Bool[Array, ""]


def _join(edges: _Edges, pieces: _Pieces) -> _Pieces:
    """Join every piece to another along its lightest edge, of equal ones the first."""
    n, e = pieces.piece.shape[0], edges.own.shape[0]
    ends = (pieces.piece[edges.own], pieces.piece[edges.other])
    between = ends[0] != ends[1]

    def least(values: Array) -> Array:
        return jnp.minimum(*(jax.ops.segment_min(values, end, num_segments=n) for end in ends))

    weight = jnp.where(between, edges.weight, jnp.inf)
    lightest = least(weight)
    number = jnp.arange(e, dtype=jnp.int32)
    # Of each end's own lightest: an edge may be that of one of its pieces and not of the other.
    chosen = jnp.minimum(
        *(
            jax.ops.segment_min(
                jnp.where((weight < jnp.inf) & (weight == lightest[end]), number, e), end, num_segments=n
            )
            for end in ends
        )
    )
    has, at = chosen < e, jnp.minimum(chosen, e - 1)
    rows = jnp.arange(n, dtype=jnp.int32)
    first, second = ends[0][at], ends[1][at]
    parent = jnp.where(has, jnp.where(first == rows, second, first), rows)
    turn = jnp.where(has, pieces.sign[edges.own[at]] * pieces.sign[edges.other[at]] * edges.agree[at], 1)
    # Two pieces that chose each other did so by the same edge: the lower is the root of what they become.
    root = (parent[parent] == rows) & (rows < parent)
    parent, turn = jnp.where(root, rows, parent), jnp.where(root, 1, turn)

    def jump(_: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        parent, turn = state
        return parent[parent], turn * turn[parent]

    rounds = max(1, (n - 1).bit_length())
    parent, turn = lax.fori_loop(jnp.int32(0), jnp.int32(rounds), jump, (parent, turn))
    return _Pieces(parent[pieces.piece], pieces.sign * turn[pieces.piece], jnp.any(has))
