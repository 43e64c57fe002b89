"""Farthest-point sampling and ball queries against NumPy loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import ball_query, farthest_point_sampling
from cablejax.types import Status

N = 70


def cloud(kind: str, axes: int = 3) -> np.ndarray:
    rng = np.random.default_rng(4)
    if kind == "ties":  # whole numbers: many are equally far, some in one place, and float32 is exact
        return rng.integers(0, 4, size=(N, axes)).astype(np.float32)
    return (rng.normal(size=(N, axes)) + 1e3 * (kind == "far")).astype(np.float32)


def sample_by_loop(xyz: np.ndarray, count: int, usable: np.ndarray, start: int) -> tuple[list[int], list[float]]:
    xyz, rows, distances = xyz.astype(np.float64), [start], [np.inf]
    while len(rows) < count:
        nearest = np.square(xyz[:, None] - xyz[rows][None]).sum(axis=2).min(axis=1)
        nearest[~usable] = -1
        nearest[rows] = -1
        row = int(np.argmax(nearest))
        if nearest[row] < 0:
            return rows + [-1] * (count - len(rows)), distances + [np.inf] * (count - len(distances))
        rows.append(row)
        distances.append(nearest[row])
    return rows, distances


@pytest.mark.parametrize(("kind", "axes"), [("ties", 3), ("ties", 1), ("normal", 2), ("far", 3)])
def test_every_point_is_the_farthest_from_those_before(kind, axes):
    xyz = cloud(kind, axes)
    sample = farthest_point_sampling(jnp.asarray(xyz), count=20)
    rows, distances = sample_by_loop(xyz, 20, np.ones(N, dtype=bool), 0)
    assert sample.rows.tolist() == rows
    np.testing.assert_allclose(sample.sq_dist, distances, rtol=1e-5)
    assert int(sample.status) == 0


def test_masked_rows_and_a_start_and_more_than_there_are():
    xyz = cloud("ties")
    mask = np.arange(N) % 3 == 1
    xyz[4] = np.nan
    usable = mask & np.isfinite(xyz).all(axis=1)
    sample = farthest_point_sampling(jnp.asarray(xyz), count=N, mask=jnp.asarray(mask), start=10)
    rows, distances = sample_by_loop(np.where(usable[:, None], xyz, 0), N, usable, 10)
    assert sample.rows.tolist() == rows
    np.testing.assert_array_equal(sample.sq_dist, np.asarray(distances, dtype=np.float32))
    assert int(sample.status) == Status.TOO_FEW_NEIGHBORS | Status.NOT_FINITE
    assert sorted(rows)[-usable.sum() :] == np.flatnonzero(usable).tolist()


@pytest.mark.parametrize("start", [0, N, -1])
def test_a_start_that_is_no_point_chooses_nothing(start):
    sample = farthest_point_sampling(jnp.asarray(cloud("ties")), count=3, mask=jnp.arange(N) > 0, start=start)
    assert sample.rows.tolist() == [-1, -1, -1]
    assert int(sample.status) == Status.INVALID


def test_an_empty_cloud_gives_none():
    sample = farthest_point_sampling(jnp.zeros((5, 3)), count=2, mask=jnp.zeros(5, dtype=bool))
    assert sample.rows.tolist() == [-1, -1]
    assert int(sample.status) == Status.EMPTY | Status.TOO_FEW_NEIGHBORS


def test_samples_under_vmap_and_x64():
    both = jnp.asarray(np.stack([cloud("ties"), cloud("ties")[::-1]]))
    with jax.enable_x64():
        rows = jax.vmap(lambda xyz: farthest_point_sampling(xyz, count=20).rows)(both)
    assert rows.dtype == jnp.int32
    for i in range(2):
        assert rows[i].tolist() == sample_by_loop(np.asarray(both[i]), 20, np.ones(N, dtype=bool), 0)[0]


def balls_by_loop(xyz: np.ndarray, queries: np.ndarray, radius: float, usable: np.ndarray) -> list[np.ndarray]:
    square = np.square(queries[:, None].astype(np.float64) - xyz[None].astype(np.float64)).sum(axis=2)
    return [np.flatnonzero(usable & (row <= radius**2)) for row in square]


# 1,500 points are more than the kernel looks at in one step.
@pytest.mark.parametrize(("axes", "copies", "capacity"), [(3, 1, 5), (1, 1, 40), (2, 22, 50)])
def test_a_ball_query_finds_the_first_rows(axes, copies, capacity):
    xyz = np.tile(cloud("ties", axes), (copies, 1))
    usable = np.arange(len(xyz)) % 5 > 0
    queries = xyz[:9] + np.float32(0.5)
    found = ball_query(jnp.asarray(xyz), jnp.asarray(queries), radius=1.5, capacity=capacity, mask=jnp.asarray(usable))
    for i, rows in enumerate(balls_by_loop(xyz, queries, 1.5, usable)):
        kept = rows[:capacity]
        assert found.neighbors[i].tolist() == [*kept.tolist(), *[-1] * (capacity - len(kept))]
        exact = np.square(xyz[kept] - queries[i]).sum(axis=1)
        np.testing.assert_array_equal(found.sq_dist[i], [*exact.tolist(), *[np.inf] * (capacity - len(kept))])
        assert int(found.count[i]) == len(rows)
        assert int(found.status[i]) == (Status.CAPACITY_EXCEEDED if len(rows) > capacity else 0)


def test_balls_in_a_box_with_bad_queries_and_radii():
    xyz, queries = jnp.array([[0.5], [9.8], [5.0]]), jnp.array([[0.0], [jnp.nan]])
    found = ball_query(xyz, queries, radius=1.0, capacity=2, box=jnp.array([10.0]))
    assert found.neighbors.tolist() == [[0, 1], [-1, -1]]
    assert found.status.tolist() == [0, Status.NOT_FINITE]
    none = ball_query(xyz, queries, radius=-1.0, capacity=2)
    assert none.neighbors.tolist() == [[-1, -1], [-1, -1]]
    assert none.status.tolist() == [Status.INVALID, Status.INVALID | Status.NOT_FINITE]


def test_balls_under_vmap_and_x64_with_gradients():
    xyz, queries = jnp.asarray(cloud("normal")), jnp.asarray(cloud("normal")[:4])
    one = ball_query(xyz, queries, radius=1.0, capacity=6)
    with jax.enable_x64():
        many = jax.vmap(lambda some: ball_query(xyz, some, radius=1.0, capacity=6))(jnp.stack([queries, queries]))
        assert many.neighbors.dtype == many.count.dtype == jnp.int32
    np.testing.assert_array_equal(many.neighbors[1], one.neighbors)

    def total(queries):
        found = ball_query(xyz, queries, radius=1.0, capacity=6)
        return jnp.sum(jnp.where(found.neighbors >= 0, found.sq_dist, 0.0))

    difference = np.asarray(queries)[:, None] - np.asarray(xyz)[np.asarray(one.neighbors)]
    exact = 2 * np.where(np.asarray(one.neighbors)[..., None] >= 0, difference, 0).sum(axis=1)
    np.testing.assert_allclose(jax.grad(total)(queries), exact, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda x: farthest_point_sampling(x, count=0), "count: expected at least 1, got 0"),
        (lambda x: ball_query(x, x, radius=1.0, capacity=0), "capacity: expected at least 1, got 0"),
        (
            lambda x: ball_query.__wrapped__.__wrapped__(x, x[:, :2], radius=1.0, capacity=1),
            r"queries: expected shape \[q, 3\], got \[5, 2\]",
        ),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make(jnp.zeros((5, 3)))
