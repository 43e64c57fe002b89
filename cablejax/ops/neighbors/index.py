"""A cloud made ready for many searches: `build_tree` once, then `query`, `query_radius` and `query_count`."""

from collections.abc import Callable
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.cloud_by_cloud import cloud_by_cloud
from cablejax.ops.neighbors.brute import count_brute, knn_brute
from cablejax.ops.neighbors.dense import FEW_CHANNELS, knn_dense
from cablejax.ops.neighbors.metric import nearest_image
from cablejax.ops.neighbors.rank import in_order
from cablejax.ops.neighbors.request import Points, as_float32, bit, prepare
from cablejax.ops.neighbors.search import Finish, search
from cablejax.ops.neighbors.tree import Tree
from cablejax.ops.neighbors.within import count_within
from cablejax.types import Status


class SearchTree(NamedTuple):
    """A cloud that can be asked for neighbours: a pytree, to be passed through `jit` and made or asked under `vmap`.

    Attributes:
        xyz: Points as given `[n, c]`. Gradients of distances go through them.
        mask: True where a row is a point `[n]`; all if None.
        row_splits: Of a ragged batch `[b + 1]` int32; one cloud if None.
        box: Lengths of the periodic box `[c]`; open space if None.
        tree: The points in the order of a tree, with boxes; None for few points or many axes, where all pairs are compared.
    """

    xyz: Float[Array, "n c"]
    mask: Bool[Array, " n"] | None
    row_splits: Int[Array, " b1"] | None
    box: Float[Array, " c"] | None
    tree: Tree | None

    def points(self) -> Points:
        """The points as a search takes them."""
        return prepare(self.xyz, self.mask, self.row_splits, self.box)

    def asking(self, queries: Array | None, row_splits: Array | None, radius: float | Array | None = None) -> Points:
        """The queries, checked against the tree; none is usable where a radius is negative or NaN."""
        points = self.points()
        asking = points if queries is None else self._others(queries, row_splits)
        if queries is None and row_splits is not None:
            raise ValueError("row_splits: expected None without queries, whose splits they are")
        conditions = [each.good for each in (points, asking) if each.good is not None]
        if radius is not None:
            if jnp.ndim(radius) > 0:
                raise ValueError(f"radius: expected one number, got shape {list(jnp.shape(radius))}")
            conditions.append(jnp.asarray(radius, dtype=jnp.float32) >= 0)
        return asking._replace(good=reduce(jnp.logical_and, conditions)) if conditions else asking

    def _others(self, queries: Array, row_splits: Array | None) -> Points:
        """Queries that are not the points themselves."""
        c = self.xyz.shape[1]
        if queries.ndim != 2 or queries.shape[1] != c:
            raise ValueError(f"queries: expected shape [q, {c}], got {list(queries.shape)}")
        if (row_splits is None) != (self.row_splits is None):
            kind = "a ragged batch" if row_splits is None else "one cloud"
            raise ValueError(f"row_splits: expected for points and queries or for neither; the tree is of {kind}")
        if row_splits is not None and self.row_splits is not None and row_splits.shape != self.row_splits.shape:
            raise ValueError(f"row_splits: expected shape {list(self.row_splits.shape)}, got {list(row_splits.shape)}")
        return prepare(queries, None, row_splits, self.box, name="queries")


class KnnResult(NamedTuple):
    """The k nearest neighbours of each query.

    Attributes:
        neighbors: Rows of `xyz` `[n, k]` int32, nearest first, equal distances by row; -1 where none is left.
        sq_dist: Squared distances `[n, k]`, inf where none is left. Differentiable in the coordinates.
        status: `Status` bits `[n]` int32: TOO_FEW_NEIGHBORS, NOT_FINITE, INVALID. Zero on padding.
    """

    neighbors: Int[Array, "n k"]
    sq_dist: Float[Array, "n k"]
    status: Int[Array, " n"]


class RadiusResult(NamedTuple):
    """The neighbours of each query within a radius.

    Attributes:
        neighbors: The nearest `capacity` of them `[n, capacity]` int32, nearest first; -1 where there are fewer.
        sq_dist: Squared distances `[n, capacity]`, inf where there are fewer. Differentiable in the coordinates.
        count: How many lie within the radius `[n]`, also beyond `capacity`.
        status: `Status` bits `[n]` int32: CAPACITY_EXCEEDED where count > capacity, NOT_FINITE, INVALID. Zero on padding.
    """

    neighbors: Int[Array, "n capacity"]
    sq_dist: Float[Array, "n capacity"]
    count: Int[Array, " n"]  # pyright: ignore[reportIncompatibleMethodOverride]
    status: Int[Array, " n"]


class RadiusCount(NamedTuple):
    """How many points lie within a radius.

    Attributes:
        count: Points `[n]` int32, 0 for padding.
        status: `Status` bits `[n]` int32: NOT_FINITE, INVALID. Zero on padding.
    """

    count: Int[Array, " n"]  # pyright: ignore[reportIncompatibleMethodOverride]
    status: Int[Array, " n"]


@jax.jit
def build_tree(
    xyz: Float[Array, "n c"],
    *,
    mask: Bool[Array, " n"] | None = None,
    row_splits: Int[Array, " b1"] | None = None,
    box: Float[Array, " c"] | None = None,
) -> SearchTree:
    """Make a cloud ready for many searches, for any k and any radius.

    Args:
        xyz: Points `[n, c]`, any unit.
        mask: True where a row of `xyz` is a point `[n]`; all if None.
        row_splits: Of a ragged batch, many clouds one after the other in `xyz`: cloud i has rows `row_splits[i]` up to
            `row_splits[i + 1]` `[b + 1]`, as in Open3D and TensorFlow. Rows before the first and from the last split on are
            padding. Neighbours come from a query's own cloud alone. Splits that do not ascend within `[0, n]` leave
            `Status.INVALID` on all rows and no neighbours.
        box: Lengths of a periodic box `[c]`, inf along an axis that does not close: a point is as far as its nearest image,
            wherever in space it was given, and is found once. A length that is not positive leaves `Status.INVALID`.

    Returns:
        The tree, for `query`, `query_radius` and `query_count`.

    Raises:
        ValueError: If the shapes do not fit together, or coordinates are float64 or integers.

    Example:
        >>> tree = build_tree(jnp.array([[0.0, 0.0], [1.0, 0.0], [9.5, 0.0]]), box=jnp.array([10.0, jnp.inf]))
        >>> query(tree, k=1).neighbors[:, 0].tolist(), query_count(tree, radius=1.0).count.tolist()
        ([2, 0, 0], [2, 1, 1])
    """
    return tree_of(xyz, mask, row_splits, box)


def query(
    tree: SearchTree,
    queries: Float[Array, "q c"] | None = None,
    *,
    k: int,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
) -> KnnResult:
    """Find the k nearest points of each query in a tree, exactly; `knn` with the tree at hand.

    Args:
        tree: From `build_tree`.
        queries: Where to search `[q, c]`; the tree's own points if None.
        k: Neighbours per query, the point itself not counted unless `include_self`. Static.
        include_self: Whether a point counts as its own neighbour; it matters without `queries` alone. Static.
        row_splits: Of the queries, where the tree is of a ragged batch: cloud i is asked by these rows `[b + 1]`.

    Returns:
        Neighbours, squared distances and status, one row per query; rows of padding hold -1, inf and 0.

    Raises:
        ValueError: If `tree` is not from `build_tree`, `k` is below 1, or the shapes do not fit together.
    """
    check_tree(tree)
    return _query(tree, queries, row_splits, k=k, include_self=include_self)


def query_radius(
    tree: SearchTree,
    queries: Float[Array, "q c"] | None = None,
    *,
    radius: float | Float[Array, ""],
    capacity: int,
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
) -> RadiusResult:
    """Find the points of a tree within a radius of each query; `radius_search` with the tree at hand.

    Args:
        tree: From `build_tree`.
        queries: As in `query` `[q, c]`.
        radius: In the unit of the points; one that is negative or NaN leaves `Status.INVALID`.
        capacity: Neighbours kept per query, the nearest, the point itself not counted unless `include_self`. Static.
        include_self: As in `query`. Static.
        row_splits: As in `query` `[b + 1]`.

    Returns:
        Neighbours, squared distances, counts and status, one row per query. Counts go beyond `capacity`, and say so.

    Raises:
        ValueError: If `tree` is not from `build_tree`, `capacity` is below 1, or the shapes do not fit together.
    """
    check_tree(tree)
    return _query_radius(tree, queries, row_splits, radius, capacity=capacity, include_self=include_self)


def query_count(
    tree: SearchTree,
    queries: Float[Array, "q c"] | None = None,
    *,
    radius: float | Float[Array, ""],
    include_self: bool = False,
    row_splits: Int[Array, " b1"] | None = None,
) -> RadiusCount:
    """Count the points of a tree within a radius of each query, distance <= radius; arguments as `query_radius`."""
    check_tree(tree)
    return _query_count(tree, queries, row_splits, radius, include_self=include_self)


def tree_of(
    xyz: Array, mask: Array | None, row_splits: Array | None, box: Array | None, *, with_tree: bool = True
) -> SearchTree:
    """`build_tree` as a part of other programs; for searches that compare all pairs, without the tree."""
    points = prepare(xyz, mask, row_splits, box)
    splits = None if row_splits is None else row_splits.astype(jnp.int32)
    tree = points.tree() if with_tree and points.has_tree() else None
    return SearchTree(as_float32(xyz, "xyz"), mask, splits, box, tree)


def knn_of(
    tree: SearchTree, queries: Array | None, row_splits: Array | None, *, k: int, include_self: bool
) -> KnnResult:
    """`query` as a part of other programs."""
    if k < 1:
        raise ValueError(f"k: expected at least 1, got {k}")
    asking = tree.asking(queries, row_splits)
    targets = _targets(tree, queries, asking)
    found = nearest_in(tree, asking, targets, k=k, include_self=include_self or queries is not None)
    return found._replace(sq_dist=differentiable(found.sq_dist, found.neighbors, tree, queries))


def within_of(
    tree: SearchTree,
    queries: Array | None,
    row_splits: Array | None,
    radius: float | Array,
    *,
    capacity: int,
    include_self: bool,
) -> RadiusResult:
    """`query_radius` as a part of other programs."""
    if capacity < 1:
        raise ValueError(f"capacity: expected at least 1, got {capacity}")
    asking = tree.asking(queries, row_splits, radius)
    targets, found_self = _targets(tree, queries, asking), include_self or queries is not None
    nearest = nearest_in(tree, asking, targets, k=capacity, include_self=found_self)
    square_radius = _square(radius)
    inside = nearest.sq_dist <= square_radius
    kept = jnp.sum(inside, axis=1, dtype=jnp.int32)
    # Who found fewer than there is room for has found all; only the others need a second look.
    count = _count_in(tree, asking, targets, square_radius, found_self, kept=kept, capacity=capacity)
    neighbors = jnp.where(inside, nearest.neighbors, -1)
    sq_dist = differentiable(nearest.sq_dist, nearest.neighbors, tree, queries)
    return RadiusResult(neighbors, jnp.where(inside, sq_dist, jnp.inf), count, count_status(asking, count, capacity))


def count_of(
    tree: SearchTree, queries: Array | None, row_splits: Array | None, radius: float | Array, *, include_self: bool
) -> RadiusCount:
    """`query_count` as a part of other programs."""
    asking = tree.asking(queries, row_splits, radius)
    targets = _targets(tree, queries, asking)
    count = _count_in(tree, asking, targets, _square(radius), include_self or queries is not None)
    return RadiusCount(count, asking.status())


_query = partial(jax.jit, static_argnames=("k", "include_self"))(knn_of)
_query_radius = partial(jax.jit, static_argnames=("capacity", "include_self"))(within_of)
_query_count = partial(jax.jit, static_argnames=("include_self",))(count_of)


def nearest_in(tree: SearchTree, asking: Points, targets: Tree | None, *, k: int, include_self: bool) -> KnnResult:
    """The k nearest points, with no gradient; by the trees if there are any, comparing all pairs if not.

    Args:
        tree: The points searched.
        asking: The queries, which are the points if `include_self` is False.
        targets: The queries as a tree, if `tree` has one.
        k: Neighbours per query. Static.
        include_self: Whether a query finds the point in its own row. Static.
    """
    if tree.tree is None:
        points, queries, skip = tree.points(), asking.columns(), _skip(asking, include_self)
        columns, box = points.columns(), points.lengths(queries.shape[1])
        if box is None and (points.segment is None or columns.shape[1] <= FEW_CHANNELS):
            neighbors, sq_dist = knn_dense(queries, columns, points.usable(), skip, k=k)
        else:
            neighbors, sq_dist = knn_brute(queries, columns, points.usable(), skip, k=k, box=box)
    else:
        assert targets is not None
        neighbors, sq_dist = by_tree(
            tree.tree, targets, asking.xyz.shape[0], k=k, include_self=include_self, finish=partial(in_order, k=k)
        )
    usable = asking.usable()
    neighbors, sq_dist = jnp.where(usable[:, None], neighbors, -1), jnp.where(usable[:, None], sq_dist, jnp.inf)
    few = usable & (neighbors[:, -1] < 0)
    return KnnResult(neighbors, sq_dist, asking.status() | bit(few, Status.TOO_FEW_NEIGHBORS))


def by_tree(tree: Tree, targets: Tree, rows: int, *, k: int, include_self: bool, finish: Finish) -> tuple[Array, ...]:
    """`search`, one cloud after the other under `vmap`."""
    return cloud_by_cloud(
        lambda tree, targets: search(tree, targets, rows, k=k, include_self=include_self, finish=finish),
        everywhere=True,
    )(tree, targets)


def _count_in(
    tree: SearchTree,
    asking: Points,
    targets: Tree | None,
    square_radius: Array,
    include_self: bool,
    *,
    kept: Array | None = None,
    capacity: int = 0,
) -> Int[Array, " q"]:
    """Points within the radius of each query, 0 for padding and what is not finite; `kept` where none reaches `capacity`."""
    rows = asking.xyz.shape[0]

    def unless_kept(kept: Array | None, count: Callable[[], Array]) -> Array:
        return count() if kept is None else jax.lax.cond(jnp.any(kept == capacity), count, lambda: kept)

    def within(tree: Tree, targets: Tree, square: Array, kept: Array | None) -> Array:
        return unless_kept(kept, lambda: count_within(tree, targets, rows, square, include_self=include_self))

    if tree.tree is None:
        points, queries = tree.points(), asking.columns()
        box, skip = points.lengths(queries.shape[1]), _skip(asking, include_self)
        columns, usable = points.columns(), points.usable()
        count = unless_kept(kept, lambda: count_brute(queries, columns, usable, skip, square_radius, box=box))
    else:
        count = cloud_by_cloud(within, everywhere=True)(tree.tree, targets, square_radius, kept)
    return jnp.where(asking.usable(), count, 0)


def check_tree(tree: object) -> None:
    """Refuse what `build_tree` did not make, and a batch of trees."""
    if not isinstance(tree, SearchTree):
        raise ValueError(f"tree: expected what cablejax.ops.build_tree returns, got {type(tree).__name__}")
    if tree.xyz.ndim != 2:
        raise ValueError(
            f"tree: expected one of points [n, c], got one of {list(tree.xyz.shape)}; ask a batch by jax.vmap"
        )


def count_status(asking: Points, count: Int[Array, " q"], capacity: int) -> Int[Array, " q"]:
    """Status of queries that found so many points within a radius."""
    return asking.status() | bit(count > capacity, Status.CAPACITY_EXCEEDED)


def _targets(tree: SearchTree, queries: Array | None, asking: Points) -> Tree | None:
    """The queries as a tree, where the points are one."""
    return tree.tree if queries is None or tree.tree is None else asking.tree()


def _skip(asking: Points, include_self: bool) -> Int[Array, " q"]:
    """The row that each query must not find, -1 for none."""
    rows = jnp.arange(asking.xyz.shape[0], dtype=jnp.int32)
    return jnp.full_like(rows, -1) if include_self else rows


def _square(radius: float | Float[Array, ""]) -> Float[Array, ""]:
    """A radius squared, as the kernels compare with it."""
    return jnp.square(jnp.asarray(radius, dtype=jnp.float32))


def differentiable(sq_dist: Array, neighbors: Array, tree: SearchTree, queries: Array | None) -> Float[Array, "q k"]:
    """Squared distances as a search found them, with the gradient that they have in the coordinates."""
    asking = tree.xyz if queries is None else as_float32(queries, "queries")
    box = None if tree.box is None else jax.lax.stop_gradient(tree.box)
    return _with_gradient(sq_dist, neighbors, tree.xyz, asking, box)


@jax.custom_jvp
def _with_gradient(sq_dist: Array, neighbors: Array, xyz: Array, queries: Array, box: Array | None) -> Array:
    """Squared distances `[q, k]`; their derivative is that of the square of the difference."""
    del neighbors, xyz, queries, box
    return sq_dist


@_with_gradient.defjvp
def _with_gradient_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    sq_dist, neighbors, xyz, queries, box = primals
    _, _, moved, moved_queries, _ = tangents
    at, found = jnp.maximum(neighbors, 0), (neighbors >= 0)[:, :, None]
    # Where there is no neighbour both factors are zero: a NaN in a row that is not used must not reach the gradient.
    difference = nearest_image(jnp.where(found, queries[:, None, :] - xyz[at], 0.0), box)
    change = jnp.where(found, moved_queries[:, None, :] - moved[at], 0.0)
    return sq_dist, 2.0 * jnp.sum(difference * change, axis=-1)
