"""What every search is asked: points, queries, who counts and who does not; checked once."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.tree import Tree, build
from cablejax.types import Status

BRUTE_POINTS = 2048  # up to here comparing all pairs costs about as little as a tree, which takes seconds to compile
AXES = 3  # up to so many a tree serves; beyond, boxes meet almost everything and all pairs are compared


class Request(NamedTuple):
    """A search with its defaults filled in; gradients stopped, points that are not finite made invalid.

    Attributes:
        xyz: Points `[n, c]` float32, zeros where invalid.
        valid: True where a row can be found `[n]`.
        queries: Where to search `[q, c]`.
        asked: True where a query is no padding `[q]`.
        finite: True where a query's coordinates are finite `[q]`.
        skip: The row that a query must not find `[q]` int32, -1 for none.
    """

    xyz: Float[Array, "n c"]
    valid: Bool[Array, " n"]
    queries: Float[Array, "q c"]
    asked: Bool[Array, " q"]
    finite: Bool[Array, " q"]
    skip: Int[Array, " q"]

    def has_tree(self) -> bool:
        """Whether a tree serves; all pairs are compared if not."""
        return self.xyz.shape[1] <= AXES and self.xyz.shape[0] > BRUTE_POINTS

    def trees(self, own: bool) -> tuple[Tree, Tree]:
        """The points and the queries as trees, which are one where the queries are the points."""
        tree = build(in_space(self.xyz), self.valid)
        return tree, tree if own else build(in_space(self.queries), self.asked & self.finite)


def prepare(xyz: Float[Array, "n c"], queries: Array | None, mask: Array | None, include_self: bool = False) -> Request:
    """Check the arguments of a search and fill in its defaults.

    Raises:
        ValueError: If the shapes do not fit together, or coordinates are no floats of at most 32 bits.
    """
    if xyz.ndim != 2 or xyz.shape[0] < 1 or xyz.shape[1] < 1:
        raise ValueError(f"xyz: expected shape [n, c] with n and c at least 1, got {list(xyz.shape)}")
    if queries is not None and (queries.ndim != 2 or queries.shape[1] != xyz.shape[1]):
        raise ValueError(f"queries: expected shape [q, {xyz.shape[1]}], got {list(queries.shape)}")
    if mask is not None and mask.shape != xyz.shape[:1]:
        raise ValueError(f"mask: expected shape [{xyz.shape[0]}], got {list(mask.shape)}")
    mask = jnp.ones(xyz.shape[0], dtype=bool) if mask is None else mask
    xyz = jax.lax.stop_gradient(as_float32(xyz, "xyz"))
    finite = jnp.isfinite(xyz).all(axis=1)
    valid = mask & finite
    clean = jnp.where(valid[:, None], xyz, 0.0)
    if queries is None:
        rows = jnp.arange(xyz.shape[0], dtype=jnp.int32)
        return Request(clean, valid, clean, mask, finite, jnp.full_like(rows, -1) if include_self else rows)
    queries = jax.lax.stop_gradient(as_float32(queries, "queries"))
    query_finite = jnp.isfinite(queries).all(axis=1)
    asked = jnp.ones(queries.shape[0], dtype=bool)
    queries = jnp.where(query_finite[:, None], queries, 0.0)
    return Request(clean, valid, queries, asked, query_finite, jnp.full(queries.shape[0], -1, dtype=jnp.int32))


def as_float32(xyz: Array, name: str) -> Float[Array, "..."]:
    """Coordinates as the kernels compute with them.

    Raises:
        ValueError: If they would lose digits: float64, and integers.
    """
    if xyz.dtype in (jnp.float32, jnp.float16, jnp.bfloat16):
        return xyz.astype(jnp.float32)
    raise ValueError(
        f"{name}: expected float32 coordinates (or float16, bfloat16), got {xyz.dtype}; "
        f"shift them near the origin, then cast: ({name} - {name}.mean(axis=0)).astype(float32)"
    )


def bit(condition: Bool[Array, " n"], status: Status) -> Int[Array, " n"]:
    """A status where a condition holds, 0 elsewhere."""
    return jnp.where(condition, jnp.int32(int(status)), jnp.int32(0))


def in_space(xyz: Float[Array, "n c"]) -> Float[Array, "n 3"]:
    """Points on a line or a plane as points in space: distances stay, to the last bit."""
    return jnp.pad(xyz, ((0, 0), (0, AXES - xyz.shape[1])))
