"""Clouds whose neighbours do not determine a surface: the filter falls back, says so, and throws nothing about."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import adaptive_filter, knn, median_outliers, statistical_outliers
from cablejax.ops.surface_fit import least_axis
from cablejax.types import PointCloud, Status

CAPACITY = 400  # one compiled shape for all clouds of a kernel


def clouds():
    rng = np.random.default_rng(4)
    angle = rng.uniform(0, np.pi, 400)
    radius = 5 + 0.1 * rng.normal(size=400)
    surface = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 10, 400)], axis=1)
    line = np.outer(np.linspace(0, 10, 200), [1.0, 2.0, -1.0])
    plane = np.column_stack([rng.uniform(0, 5, (300, 2)), np.zeros(300)])
    return {
        "surface": surface,
        "volume of 100": rng.uniform(0, 1, (100, 3)),
        "volume of 300": rng.uniform(0, 1, (300, 3)),
        "coarse grid": np.round(surface),
        "fine grid": np.round(surface, 1),
        "line": line,
        "two lines": np.concatenate([line, line + np.array([0.0, 0.3, 0.6])]),
        "noisy line": line + 0.01 * rng.normal(size=line.shape),
        "plane": plane,
        "lattice": np.stack(np.meshgrid(*[np.arange(7.0)] * 3), axis=-1).reshape(-1, 3),
        "each twice": np.repeat(surface[:200], 2, axis=0),
        "each ten times": np.repeat(surface[:40], 10, axis=0),
        "all at one place": np.ones((50, 3)),
        "three points": surface[:3],
    }


CLOUDS = clouds()


def assert_none_is_lost_or_thrown(cloud, xyz, k, name):
    moved = np.linalg.norm(np.asarray(xyz - cloud.xyz), axis=1)
    assert np.isfinite(np.asarray(xyz)).all(), name
    found = np.asarray(knn(cloud.xyz, k=k, mask=cloud.mask).sq_dist)
    reach = np.sqrt(np.max(np.where(np.isfinite(found), found, 0.0), axis=1))
    assert (moved <= 1.001 * reach + 1e-5).all(), name


@pytest.mark.parametrize(("order", "k"), [(0, 3), (1, 3), (2, 3), (2, 20)])
def test_no_point_is_lost_or_thrown(order, k):
    for name, xyz in CLOUDS.items():
        cloud = PointCloud.from_xyz(xyz, capacity=CAPACITY)
        assert_none_is_lost_or_thrown(cloud, adaptive_filter(cloud, k=k, order=order).xyz, k, name)


FEW = 5


@partial(jax.jit, static_argnames="order")
def with_few(cloud, *, order):
    """The filter with few neighbours, and the gradient of a function of what it gives."""

    def total(xyz):
        result = adaptive_filter(PointCloud(xyz, cloud.mask), k=FEW, order=order, gamma=0.1)
        return jnp.square(result.xyz).sum(), result

    (_, result), gradient = jax.value_and_grad(total, has_aux=True)(cloud.xyz)
    return result, gradient


@pytest.mark.parametrize("order", [0, 1, 2])
def test_with_few_neighbours_no_point_is_lost_and_gradients_are_finite(order):
    for name, xyz in CLOUDS.items():
        cloud = PointCloud.from_xyz(xyz, capacity=CAPACITY)
        result, gradient = with_few(cloud, order=order)
        assert_none_is_lost_or_thrown(cloud, result.xyz, FEW, name)
        assert np.isfinite(np.asarray(gradient)).all(), name


@pytest.mark.parametrize("order", [1, 2])
def test_a_plane_is_a_fixed_point_however_little_of_it_is_seen(order):
    result, _ = with_few(PointCloud.from_xyz(CLOUDS["plane"], capacity=CAPACITY), order=order)
    np.testing.assert_allclose(result.xyz[:300, 2], 0.0, atol=1e-5)


def fallen_back(name, **options):
    result = adaptive_filter(PointCloud.from_xyz(CLOUDS[name], capacity=CAPACITY), **options)
    return (np.asarray(result.status)[: len(CLOUDS[name])] & Status.LOWER_ORDER) != 0


def test_the_status_says_where_a_simpler_surface_was_taken():
    assert fallen_back("surface", k=3, order=2).all()  # four points determine no quadric
    assert fallen_back("surface", k=20, order=2, alpha=1.0).mean() < 0.02
    assert fallen_back("line", k=20, order=2, alpha=1.0).all()
    assert fallen_back("line", k=20, order=1, alpha=1.0).all()
    assert fallen_back("two lines", k=20, order=2, alpha=1.0).mean() > 0.9
    assert not fallen_back("plane", k=20, order=1, alpha=1.0).any()
    assert not fallen_back("surface", k=3, order=0).any()


@pytest.mark.parametrize("removal", ["statistical", "statistical, found", "median"])
def test_gradients_of_the_scores_are_finite(removal):
    def total(xyz, mask):
        cloud = PointCloud(xyz, mask)
        if removal == "median":
            result = median_outliers(cloud, k=5)
        else:
            found = None if removal == "statistical" else knn(xyz, k=5, mask=mask)
            result = statistical_outliers(cloud, k=5, found=found)
        return result.score.sum() + result.threshold

    gradient = jax.jit(jax.grad(total))
    for name, xyz in CLOUDS.items():
        cloud = PointCloud.from_xyz(xyz, capacity=CAPACITY)
        assert np.isfinite(np.asarray(gradient(cloud.xyz, cloud.mask))).all(), name


@pytest.mark.parametrize("times", [5, 10])
def test_duplicates_alone_are_no_outliers(times):
    xyz = np.repeat(CLOUDS["surface"][:40], times, axis=0)
    result = statistical_outliers(PointCloud.from_xyz(xyz, capacity=CAPACITY), k=5)
    assert np.asarray(result.keep)[: len(xyz)].all()
    assert not np.asarray(result.keep)[len(xyz) :].any()


def test_a_thin_wall_keeps_its_thickness():
    rng = np.random.default_rng(0)
    n, thickness, noise = 1500, 0.06, 0.005
    side = np.where(rng.random(n) < 0.5, 0.5, -0.5) * thickness
    xyz = np.column_stack([rng.uniform(-0.39, 0.39, (n, 2)), side]) + noise * rng.normal(size=(n, 3))
    # The shape of the other tests of the filter with its defaults: one program for all.
    result = np.asarray(adaptive_filter(PointCloud.from_xyz(xyz, capacity=2048), order=2).xyz)[:n]
    inside = np.abs(xyz[:, :2]).max(axis=1) < 0.3
    before, after = (np.abs(p[:, 2] - side)[inside] for p in (xyz, result))
    assert np.sqrt(np.mean(after**2)) < 0.8 * np.sqrt(np.mean(before**2))


def test_the_gradient_of_the_normal_is_that_of_differences():
    with jax.enable_x64(True):
        rng = np.random.default_rng(0)
        spread = rng.normal(size=(30, 5, 3)) * [3.0, 2.0, 0.5] @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = np.einsum("kmi,kmj->ijm", spread, spread) / 30
        packed = jnp.asarray([matrix[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))])
        change = jnp.asarray(rng.normal(size=packed.shape))
        at = jax.jit(lambda packed, change: jax.jvp(least_axis, (packed,), (change,)))
        (normal, _least), (turn, growth) = at(packed, change)
        step = 1e-5
        ahead, behind = (at(packed + sign * step * change, change)[0] for sign in (1, -1))
        np.testing.assert_allclose(turn, (ahead[0] - behind[0]) / (2 * step), atol=1e-3)
        np.testing.assert_allclose(growth, (ahead[1] - behind[1]) / (2 * step), atol=1e-3)
        np.testing.assert_allclose((normal * turn).sum(axis=0), 0.0, atol=1e-6)
