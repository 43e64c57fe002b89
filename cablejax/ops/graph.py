"""Neighbour graphs as edge lists (COO): what message passing over a cloud asks for."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors import KnnResult, RadiusResult, knn, radius_search
from cablejax.types import Status


class EdgeList(NamedTuple):
    """The edges of a graph, by receiver, then by distance, then by sender.

    Attributes:
        senders: The neighbour, a row of the points `[capacity]` int32; -1 from `count` on.
        receivers: Whose neighbour it is, a row of the queries `[capacity]` int32; -1 from `count` on.
        sq_dist: Squared distances `[capacity]`, inf from `count` on. Differentiable in the coordinates.
        count: How many edges there are, also beyond the capacity `[]` int32.
        most: Neighbours of the point that has most, also beyond what was kept of them `[]` int32.
        status: `Status` bits of all points and of the list `[]` int32: CAPACITY_EXCEEDED where edges are missing.
    """

    senders: Int[Array, " capacity"]
    receivers: Int[Array, " capacity"]
    sq_dist: Float[Array, " capacity"]
    count: Int[Array, ""]  # pyright: ignore[reportIncompatibleMethodOverride]
    most: Int[Array, ""]
    status: Int[Array, ""]


@partial(jax.jit, static_argnames=("k", "capacity", "include_self"))
def knn_graph(
    xyz: Float[Array, "n c"],
    *,
    k: int,
    capacity: int | None = None,
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
    query_row_splits: Int[Array, " b1"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> EdgeList:
    """Edges to each point from its k nearest: `knn`, the padded form of the same graph, as a list.

    Args:
        xyz: Points `[n, c]`, any unit.
        k: Neighbours per point, the point itself not counted unless `include_self`. Static.
        capacity: Length of the list; all possible edges, n times k, if None. Static.
        queries: As the rest, of `knn`.
        mask: See there.
        include_self: See there. Static.
        row_splits: See there.
        query_row_splits: See there.
        box: See there.

    Returns:
        The edges, their number and status.

    Raises:
        ValueError: If `k` or `capacity` is below 1, or as `knn`.

    Example:
        >>> graph = knn_graph(jnp.array([[0.0], [1.0], [3.0]]), k=1)
        >>> graph.senders.tolist(), graph.receivers.tolist(), int(graph.count)
        ([1, 0, 1], [0, 1, 2], 3)
    """
    found = knn(
        xyz, k=k, queries=queries, mask=mask, include_self=include_self, row_splits=row_splits,
        query_row_splits=query_row_splits, box=box,
    )  # fmt: skip
    return edge_list(found, capacity=found.neighbors.size if capacity is None else capacity)


@partial(jax.jit, static_argnames=("capacity", "max_neighbors", "include_self"))
def radius_graph(
    xyz: Float[Array, "n c"],
    *,
    radius: float | Float[Array, ""],
    max_neighbors: int,
    capacity: int | None = None,
    queries: Float[Array, "q c"] | None = None,
    mask: Bool[Array, " n"] | None = None,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
    query_row_splits: Int[Array, " b1"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> EdgeList:
    """Edges to each point from those within a radius: `radius_search`, the padded form of the same graph, as a list.

    Args:
        xyz: Points `[n, c]`, any unit.
        radius: In the unit of `xyz`; the boundary belongs to it.
        max_neighbors: Neighbours kept per point, the nearest, the point itself not counted unless `include_self`. Static.
        capacity: Length of the list; n times `max_neighbors` if None. Static.
        queries: As the rest, of `radius_search`.
        mask: See there.
        include_self: See there. Static.
        row_splits: See there.
        query_row_splits: See there.
        box: See there.

    Returns:
        The edges, their number (with `max_neighbors` as it is), the neighbours of the point with most, and status. Where
        that holds CAPACITY_EXCEEDED a `max_neighbors` of `most` and a `capacity` of `count` are enough.

    Raises:
        ValueError: If `max_neighbors` or `capacity` is below 1, or as `radius_search`.

    Example:
        >>> graph = radius_graph(jnp.array([[0.0], [1.0], [3.0]]), radius=1.5, max_neighbors=2, capacity=4)
        >>> graph.senders.tolist(), graph.receivers.tolist(), int(graph.count)
        ([1, 0, -1, -1], [0, 1, -1, -1], 2)
    """
    if max_neighbors < 1:
        raise ValueError(f"max_neighbors: expected at least 1, got {max_neighbors}")
    found = radius_search(
        xyz, radius=radius, capacity=max_neighbors, queries=queries, mask=mask, include_self=include_self,
        row_splits=row_splits, query_row_splits=query_row_splits, box=box,
    )  # fmt: skip
    return edge_list(found, capacity=found.neighbors.size if capacity is None else capacity)


@partial(jax.jit, static_argnames=("capacity",))
def edge_list(found: KnnResult | RadiusResult, *, capacity: int) -> EdgeList:
    """The edges of a search made elsewhere, such as one with a tree.

    Args:
        found: What `query`, `query_radius`, `knn` or `radius_search` gave for q queries and k places each.
        capacity: Length of the list. Static.

    Returns:
        The edges, their number and status.

    Raises:
        ValueError: If `capacity` is below 1, or the q times k places are more than int32 can number.
    """
    if capacity < 1:
        raise ValueError(f"capacity: expected at least 1, got {capacity}")
    q, k = found.neighbors.shape
    if q * k >= 2**31:
        raise ValueError(f"found: expected fewer than 2**31 places, got {q} x {k}")
    there = (found.neighbors >= 0).reshape(-1)
    place = jnp.nonzero(there, size=capacity, fill_value=q * k)[0].astype(jnp.int32)
    real, at = place < q * k, jnp.minimum(place, q * k - 1)
    count, each = jnp.sum(there, dtype=jnp.int32), jnp.sum(found.neighbors >= 0, axis=1, dtype=jnp.int32)
    most = jnp.max(found.count if isinstance(found, RadiusResult) else each)
    bits = jax.lax.reduce(found.status, jnp.int32(0), jax.lax.bitwise_or, (0,))
    return EdgeList(
        senders=jnp.where(real, found.neighbors.reshape(-1)[at], -1),
        receivers=jnp.where(real, at // k, -1),
        sq_dist=jnp.where(real, found.sq_dist.reshape(-1)[at], jnp.inf),
        count=count,
        most=most,
        status=bits | jnp.where(count > capacity, int(Status.CAPACITY_EXCEEDED), 0).astype(jnp.int32),
    )
