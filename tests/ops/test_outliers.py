"""Outlier removal against Open3D and NumPy float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import knn, median_outliers, radius_outliers, statistical_outliers
from cablejax.types import PointCloud, Status

N = 1200


def scan(seed=0):
    """A noisy half-cylinder with a few points in the air."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, np.pi, N), 5 + 0.1 * rng.normal(size=N)
    xyz = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 20, N)], axis=1)
    xyz[::40] += rng.uniform(-8, 8, (30, 3))
    return xyz.astype(np.float32)


def exact(xyz):
    """A cloud without padding."""
    return PointCloud.from_xyz(xyz, capacity=len(xyz))


def assert_kept(result, kept, margin=1e-5):
    """The same points, except where the score is the threshold to rounding."""
    expected = np.zeros(len(result.keep), dtype=bool)
    expected[kept] = True
    wrong = np.asarray(result.keep) != expected
    assert (np.abs(np.asarray(result.score) - result.threshold)[wrong] < margin * float(result.threshold)).all()
    assert wrong.sum() <= 1
    assert 0 < expected.sum() < len(expected)


@pytest.mark.parametrize(("k", "std_ratio"), [(20, 2.0), (8, 1.0), (2, 3.0)])
def test_statistical_removal_equals_open3d(open3d_cloud, k, std_ratio):
    _, kept = open3d_cloud(scan()).remove_statistical_outlier(k, std_ratio)
    assert_kept(statistical_outliers(exact(scan()), k=k, std_ratio=std_ratio), kept)


@pytest.mark.parametrize(("radius", "min_neighbors"), [(0.8, 5), (0.5, 2), (1.5, 16)])
def test_radius_removal_equals_open3d(open3d_cloud, radius, min_neighbors):
    _, kept = open3d_cloud(scan()).remove_radius_outlier(min_neighbors, radius)
    result = radius_outliers(exact(scan()), radius=radius, min_neighbors=min_neighbors)
    np.testing.assert_array_equal(np.flatnonzero(result.keep), sorted(kept))


@pytest.mark.parametrize("n", [N, 5])  # five points have fewer neighbours than the search asked for
def test_a_search_made_elsewhere_gives_the_same(n):
    cloud = exact(scan()[:n])
    found = knn(cloud.xyz, k=12, mask=cloud.mask)
    for k in (4, 8):
        shared, alone = statistical_outliers(cloud, k=k, found=found), statistical_outliers(cloud, k=k)
        np.testing.assert_array_equal(shared.keep, alone.keep)
        np.testing.assert_allclose(shared.score, alone.score, rtol=1e-6)  # sums of k roots in another order
        assert int(shared.status) == int(alone.status)


def test_median_removal_equals_numpy():
    xyz, k, ratio = scan().astype(np.float64), 9, 3.0
    distance = np.linalg.norm(xyz[:, None] - xyz, axis=2)
    np.fill_diagonal(distance, np.inf)
    near = xyz[np.argsort(distance, axis=1)[:, :k]]
    score = np.linalg.norm(xyz - np.median(near, axis=1), axis=1)
    result = median_outliers(exact(scan()), k=k, ratio=ratio)
    np.testing.assert_allclose(result.score, score, rtol=1e-4, atol=1e-5)
    assert_kept(result, np.flatnonzero(score <= ratio * np.median(score)))


REMOVALS = {
    "statistical": lambda cloud: statistical_outliers(cloud, k=10),
    "radius": lambda cloud: radius_outliers(cloud, radius=0.8, min_neighbors=4),
    "median": lambda cloud: median_outliers(cloud, k=10),
}


@pytest.mark.parametrize("name", REMOVALS)
def test_laws(name):
    remove, xyz, rng = REMOVALS[name], scan(), np.random.default_rng(1)
    plain = np.asarray(remove(exact(xyz)).keep)
    shuffle = rng.permutation(N)
    np.testing.assert_array_equal(remove(exact(xyz[shuffle])).keep, plain[shuffle])
    padded = np.concatenate([xyz, np.full((50, 3), 0.1), np.full((1, 3), np.nan)]).astype(np.float32)
    result = remove(PointCloud(jnp.asarray(padded), (jnp.arange(N + 51) < N).at[-1].set(True)))
    np.testing.assert_array_equal(result.keep[:N], plain)
    assert not np.asarray(result.keep)[N:].any()
    assert int(result.status) == Status.NOT_FINITE
    if name == "median":  # taken coordinate by coordinate, so it depends on the axes
        return
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = remove(exact((xyz @ rotation).astype(np.float32))).keep
    assert (np.asarray(turned) != plain).sum() <= 1  # a score may cross the threshold by rounding


@pytest.mark.parametrize("name", REMOVALS)
def test_vmap_equals_loop(name):
    clouds = jnp.stack([jnp.asarray(scan(0)), jnp.asarray(scan(1))])
    mask = jnp.ones(N, dtype=bool)
    together = jax.vmap(lambda xyz: REMOVALS[name](PointCloud(xyz, mask)).keep)(clouds)
    for i in range(2):
        np.testing.assert_array_equal(together[i], REMOVALS[name](PointCloud(clouds[i], mask)).keep)


@pytest.mark.parametrize("name", REMOVALS)
def test_empty_cloud_keeps_nothing_and_says_so(name):
    result = REMOVALS[name](PointCloud(jnp.zeros((N, 3)), jnp.zeros(N, dtype=bool)))
    assert not np.asarray(result.keep).any()
    assert int(result.status) & Status.EMPTY


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="k: expected at least 2"):
        statistical_outliers(exact(scan()), k=1)
    cloud = exact(scan())
    with pytest.raises(ValueError, match=r"found: expected neighbours \[1200, at least 19\], got \[1200, 9\]"):
        statistical_outliers(cloud, k=20, found=knn(cloud.xyz, k=9))
    with pytest.raises(ValueError, match="k: expected at least 1, got 0"):
        median_outliers(exact(scan()), k=0)


def test_a_radius_that_is_none_keeps_nothing_and_says_so():
    cloud = PointCloud.from_xyz(scan()[:50])
    found = radius_outliers(cloud, radius=-1.0, min_neighbors=0)
    assert not np.asarray(found.keep).any()
    assert int(found.status) == Status.INVALID
