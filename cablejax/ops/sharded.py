"""One search over several devices: each holds the tree and is asked a part of the queries."""

from functools import partial

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float

from cablejax.ops.neighbors import KnnResult, SearchTree
from cablejax.ops.neighbors.index import check_tree, differentiable, knn_of
from cablejax.ops.neighbors.request import bit
from cablejax.types import Status


def query_sharded(
    tree: SearchTree,
    queries: Float[Array, "q c"] | None = None,
    *,
    k: int,
    mesh: Mesh,
    include_self: bool = False,
) -> KnnResult:
    """`query` with the queries dealt out to the devices of a mesh, in the order of their rows.

    The result is sharded by rows as the queries are. Rows that lie near each other in space should be near each other in
    number, as a scanner's are: each device looks at the leaves that its own queries need.

    Args:
        tree: From `build_tree`, of one cloud; every device gets all of it.
        queries: Where to search `[q, c]`, any number; the tree's own points if None.
        k: Neighbours per query, the point itself not counted unless `include_self`. Static.
        mesh: Devices, such as `jax.make_mesh((jax.device_count(),), ("devices",))`; all its axes are used.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.

    Returns:
        What `query` gives.

    Raises:
        ValueError: If `tree` is not from `build_tree` or is of a ragged batch, `k` is below 1, or the shapes do not fit.

    Example:
        >>> mesh = jax.make_mesh((jax.device_count(),), ("devices",))
        >>> from cablejax.ops import build_tree
        >>> query_sharded(build_tree(jnp.array([[0.0], [1.0], [3.0]])), k=1, mesh=mesh).neighbors[:, 0].tolist()
        [1, 0, 1]
    """
    check_tree(tree)
    if tree.row_splits is not None:
        raise ValueError("tree: expected one of one cloud, got one of a ragged batch, which is searched as one already")
    # Whatever types its axes have: the queries' own sharding decides nothing.
    mesh = Mesh(mesh.devices, mesh.axis_names, axis_types=(AxisType.Auto,) * len(mesh.axis_names))
    return _query_sharded(tree, queries, k=k, mesh=mesh, include_self=include_self)


@partial(jax.jit, static_argnames=("k", "mesh", "include_self"))
def _query_sharded(tree: SearchTree, queries: Array | None, *, k: int, mesh: Mesh, include_self: bool) -> KnnResult:
    own = queries is None and not include_self
    asked = tree.asking(queries, None).asked
    where = tree.xyz if queries is None else queries
    q, split = where.shape[0], PartitionSpec(mesh.axis_names)
    spare = -q % mesh.size
    # Padding asks from the place of the last query, so that it widens no box.
    padded = jnp.pad(jax.lax.stop_gradient(where), ((0, spare), (0, 0)), mode="edge")
    asked = jnp.pad(asked, (0, spare))
    row = jnp.arange(q + spare, dtype=jnp.int32) if own else jnp.full(q + spare, -1, dtype=jnp.int32)

    @partial(jax.shard_map, mesh=mesh, in_specs=(PartitionSpec(), split, split, split), out_specs=split)
    def ask(tree: SearchTree, queries: Array, asked: Array, row: Array) -> KnnResult:
        found = knn_of(tree, queries, None, k=k + own, include_self=True)
        return _for(_without(found, row, k) if own else found, asked)

    plain = tree._replace(xyz=jax.lax.stop_gradient(tree.xyz))
    found: KnnResult = jax.tree.map(lambda each: each[:q], ask(plain, padded, asked, row))
    return found._replace(sq_dist=differentiable(found.sq_dist, found.neighbors, tree, queries))


def _without(found: KnnResult, row: Array, k: int) -> KnnResult:
    """The k nearest without a query's own row: of k + 1, that row or, where duplicates of lower rows fill them, the last."""
    own = found.neighbors == row[:, None]
    passed = jnp.cumsum(own, axis=1, dtype=jnp.int32)[:, :k]
    at = jnp.arange(k, dtype=jnp.int32)[None, :] + passed
    neighbors, sq_dist = (jnp.take_along_axis(each, at, axis=1) for each in (found.neighbors, found.sq_dist))
    usable = (found.status & int(Status.NOT_FINITE | Status.INVALID)) == 0
    few = bit(usable & (neighbors[:, -1] < 0), Status.TOO_FEW_NEIGHBORS)
    return KnnResult(neighbors, sq_dist, found.status & ~int(Status.TOO_FEW_NEIGHBORS) | few)


def _for(found: KnnResult, asked: Bool[Array, " q"]) -> KnnResult:
    """What was found by those who asked; padding finds nothing."""
    return KnnResult(
        jnp.where(asked[:, None], found.neighbors, -1),
        jnp.where(asked[:, None], found.sq_dist, jnp.inf),
        jnp.where(asked, found.status, 0),
    )
