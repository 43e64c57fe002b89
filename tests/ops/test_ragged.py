"""Ragged batches: many clouds in one array, searched as one, each among its own points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import build_tree, knn, query, query_radius, radius_count, radius_search
from cablejax.types import Status
from tests.reference import neighbors as reference

K = 5
PADDING = 6


def clouds(sizes: tuple[int, ...], axes: int, kind: str) -> list[np.ndarray]:
    """Clouds of any size and place: some overlap, some lie far from the origin and from each other."""
    rng = np.random.default_rng(3)
    made = []
    for number, size in enumerate(sizes):
        if kind == "ties":
            xyz = rng.integers(0, 4, size=(size, axes)).astype(np.float64)
        elif kind == "equal":
            xyz = np.full((size, axes), 2.5)
        else:
            xyz = rng.normal(size=(size, axes)) * 10.0 ** (number % 5 - 2) + (number % 3) * 1e4
        made.append(xyz.astype(np.float32))
    return made


def packed(parts: list[np.ndarray]) -> tuple[jax.Array, jax.Array]:
    splits = np.cumsum([0, *(len(part) for part in parts)])
    padding = np.full((PADDING, parts[0].shape[1]), np.nan, dtype=np.float32)
    return jnp.asarray(np.concatenate([*parts, padding])), jnp.asarray(splits, dtype=jnp.int32)


@pytest.mark.parametrize(
    ("axes", "kind"),
    [(3, "ties"), (3, "equal"), (3, "spread"), (1, "spread"), (2, "ties"), (5, "spread"), (12, "spread")],
)
def test_every_cloud_is_searched_alone(axes, kind):
    parts = clouds((70, 0, 1, 3, 120, 0, 40), axes, kind)
    xyz, splits = packed(parts)
    found = knn(xyz, k=K, row_splits=splits)
    for first, part in zip(np.asarray(splits), parts, strict=False):
        if len(part):
            rows, exact = reference.knn(part, K)
            own = slice(first, first + len(part))
            np.testing.assert_allclose(found.sq_dist[own], exact, rtol=axes * 4e-7)
            assert ((np.asarray(found.neighbors[own]) >= 0) == (rows >= 0)).all()
            if kind != "spread":  # distances of whole numbers are exact: ties fall by row
                np.testing.assert_array_equal(found.neighbors[own], np.where(rows >= 0, rows + first, -1))
            few = Status.TOO_FEW_NEIGHBORS if len(part) <= K else 0
            assert (np.asarray(found.status[own]) == few).all()
    assert (np.asarray(found.neighbors[-PADDING:]) == -1).all()
    assert not np.asarray(found.status[-PADDING:]).any()


@pytest.mark.parametrize("sizes", [(1300, 2, 0, 1, 900, 500, 30), (1137, *range(40), *(2, 0, 1) * 20, *(6,) * 126)])
def test_by_the_tree_a_batch_gives_what_its_clouds_give(sizes):
    parts = clouds(sizes, 3, "spread")
    parts[0][:600] = parts[0][0]  # the slow cloud: hundreds of equal points
    xyz, splits = packed(parts)
    splits = jnp.pad(splits, (0, 300 - splits.shape[0]), mode="edge")  # one program for both: the rest is empty clouds
    tree = build_tree(xyz, row_splits=splits)
    assert tree.tree is not None
    found, near = query(tree, k=K), query_radius(tree, radius=0.5, capacity=K)
    for first, part in zip(np.asarray(splits), parts, strict=False):
        if len(part):
            own, there = slice(first, first + len(part)), np.asarray(found.neighbors[first : first + len(part)])
            exact = reference.knn(part, K)[1]
            np.testing.assert_allclose(found.sq_dist[own], exact, rtol=1e-6)
            assert ((there == -1) | ((there >= first) & (there < first + len(part)))).all()
            # The pairs whose distance is the radius to float32 rounding may fall on either side.
            count, sure = reference_count(part, 0.5)
            np.testing.assert_array_equal(np.asarray(near.count[own])[sure], count[sure])
    assert (np.asarray(found.neighbors[-PADDING:]) == -1).all()


def reference_count(xyz: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    tree = cKDTree(xyz.astype(np.float64))
    low, count, high = (
        tree.query_ball_point(tree.data, radius * scale, return_length=True) for scale in (1 - 1e-6, 1.0, 1 + 1e-6)
    )
    return count - 1, low == high


def test_queries_ask_their_own_cloud():
    parts, asked = clouds((50, 0, 80), 3, "spread"), [np.zeros((4, 3)), np.ones((3, 3)), np.full((2, 3), 2e4)]
    xyz, splits = packed(parts)
    queries = jnp.asarray(np.concatenate(asked), dtype=jnp.float32)
    query_splits = jnp.array([0, 4, 7, 9])
    found = knn(xyz, k=K, queries=queries, row_splits=splits, query_row_splits=query_splits)
    assert ((np.asarray(found.neighbors[:4]) >= 0) & (np.asarray(found.neighbors[:4]) < 50)).all()
    assert (np.asarray(found.neighbors[4:7]) == -1).all()
    assert (np.asarray(found.status[4:7]) == Status.TOO_FEW_NEIGHBORS).all()
    assert ((np.asarray(found.neighbors[7:]) >= 50) & (np.asarray(found.neighbors[7:]) < 130)).all()
    np.testing.assert_allclose(found.sq_dist[:4], reference.knn(parts[0], K, queries=asked[0])[1], rtol=1e-6)


def test_masked_rows_and_the_box_go_with_row_splits():
    parts = [np.array([[0.1], [0.5], [9.9]], np.float32), np.array([[0.2], [9.8], [5.0]], np.float32)]
    xyz, splits = packed(parts)
    mask = jnp.arange(len(xyz)) != 1
    found = radius_search(xyz, radius=1.0, capacity=2, row_splits=splits, mask=mask, box=jnp.array([10.0]))
    assert np.asarray(found.neighbors[:6]).tolist() == [[2, -1], [-1, -1], [0, -1], [4, -1], [3, -1], [-1, -1]]
    assert np.asarray(radius_count(xyz, radius=1.0, row_splits=splits, mask=mask).count).sum() == 0


@pytest.mark.parametrize("splits", [[0, 30, 20, 50], [-1, 20, 40, 50], [0, 20, 40, 51]])
def test_splits_that_do_not_ascend_within_the_rows_say_so(splits):
    found = knn(jnp.zeros((50, 3)), k=2, row_splits=jnp.array(splits))
    assert (np.asarray(found.neighbors) == -1).all()
    assert (np.asarray(found.status) == Status.INVALID).all()


def test_rows_before_the_first_split_are_padding():
    found = knn(jnp.zeros((9, 3)), k=1, row_splits=jnp.array([2, 5]))
    assert np.asarray(found.neighbors)[:, 0].tolist() == [-1, -1, 3, 2, 2, -1, -1, -1, -1]
    assert not np.asarray(found.status).any()


def test_under_x64_and_vmap():
    xyz, splits = packed(clouds((40, 60), 3, "spread"))
    one = knn(xyz, k=K, row_splits=splits)
    with jax.enable_x64():
        many = jax.vmap(lambda xyz, splits: knn(xyz, k=K, row_splits=splits))(
            jnp.stack([xyz, xyz]), jnp.stack([splits] * 2)
        )
    for found, expected in zip(many, one, strict=True):
        np.testing.assert_array_equal(found[1], expected)


def test_gradients_stay_within_a_cloud():
    xyz, splits = packed(clouds((40, 60), 3, "spread"))

    def of_the_first(xyz):
        near = knn(xyz, k=K, row_splits=splits)
        return jnp.sum(jnp.where(near.neighbors >= 0, near.sq_dist, 0.0)[:40])

    gradient = np.asarray(jax.grad(of_the_first)(xyz))
    assert np.isfinite(gradient).all()
    assert gradient[:40].any()
    assert not gradient[40:].any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"row_splits": np.array([0])}, r"row_splits: expected shape \[b \+ 1\] for b clouds, got \[1\]"),
        (
            {"row_splits": np.array([0, 9]), "queries": np.zeros((2, 3))},
            "row_splits: .* the tree is of a ragged batch",
        ),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        knn.__wrapped__.__wrapped__(jnp.zeros((9, 3)), k=1, **jax.tree.map(jnp.asarray, arguments))
