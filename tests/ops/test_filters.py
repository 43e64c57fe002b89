"""The adaptive filter against eqs. (2)-(8) in NumPy float64, and what it does to a cable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import KnnResult, adaptive_filter, knn
from cablejax.ops.surface_fit import fit_surface, least_axis
from cablejax.types import PointCloud, Status
from tests.reference import filters as reference

N = 300
SETTINGS = {"k": 16, "alpha": 0.8, "beta": 0.1, "gamma": 0.2, "tau": 3.0}


def half_cylinder(n, *, radius=15.0, noise=0.3, length=30.0, seed=3):
    """Points of a half-cylinder along z, displaced along its radius."""
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0, np.pi, n), radius + noise * rng.normal(size=n)
    return np.stack([r * np.cos(angle), r * np.sin(angle), rng.uniform(0, length, n)], axis=1).astype(np.float32)


def exact(xyz):
    """A cloud without padding."""
    return PointCloud.from_xyz(xyz, capacity=len(xyz))


def cloud(n=N, **kwargs):
    return exact(half_cylinder(n, radius=5.0, length=10.0, **kwargs))


@pytest.mark.parametrize(
    ("order", "form", "refinements"),
    [
        (0, "linear", 0),
        (0, "exponential", 0),
        (1, "linear", 0),
        (1, "linear", 1),
        (2, "exponential", 0),
        (2, "linear", 2),
    ],
)
def test_equals_the_reference(order, form, refinements):
    points, how = cloud(), {"order": order, "form": form, "refinements": refinements}
    result = adaptive_filter(points, **how, **SETTINGS)
    xyz, width = reference.adaptive_filter(points.xyz, **how, **SETTINGS)
    np.testing.assert_allclose(result.width, width, rtol=1e-5)
    # Normal equations in float32 on terms of size one: 1e-6 times a condition of at most some hundred.
    np.testing.assert_allclose(result.xyz, xyz, atol=2e-6 if order == 0 else 3e-4)


@pytest.mark.parametrize("order", [0, 2])
def test_iterations_apply_the_filter_again(order):
    points = cloud()
    twice = adaptive_filter(points, order=order, iterations=2, **SETTINGS)
    first = adaptive_filter(points, order=order, **SETTINGS)
    again = adaptive_filter(PointCloud(first.xyz, points.mask), order=order, **SETTINGS)
    np.testing.assert_allclose(twice.xyz, again.xyz, atol=1e-4)


@pytest.mark.parametrize("order", [0, 2])
def test_rotation_translation_and_order_of_points(order):
    points, rng = half_cylinder(N, radius=5.0, length=10.0), np.random.default_rng(0)
    plain = np.asarray(adaptive_filter(exact(points), order=order, **SETTINGS).xyz)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0].astype(np.float32)
    turned = adaptive_filter(exact(points @ rotation), order=order, **SETTINGS).xyz
    np.testing.assert_allclose(turned, plain @ rotation, atol=1e-3)
    # float32 holds coordinates near 1e4 to 5e-4: half of that moves every input, and a point on the edge of a
    # neighbourhood in or out, so a few outputs jump.
    moved = adaptive_filter(exact(points + np.float32(1e4)), order=order, **SETTINGS).xyz
    change = np.abs(np.asarray(moved, dtype=np.float64) - 1e4 - plain).max(axis=1)
    assert np.quantile(change, 0.98) < 5e-3
    shuffle = rng.permutation(N)
    shuffled = adaptive_filter(exact(points[shuffle]), order=order, **SETTINGS).xyz
    np.testing.assert_allclose(shuffled, plain[shuffle], atol=1e-4)


@pytest.mark.parametrize("order", [0, 2])
def test_padding_and_points_that_are_not_finite_come_back_unchanged(order):
    points = half_cylinder(N, radius=5.0, length=10.0)
    padded = np.concatenate([points, np.full((20, 3), 7.0), np.full((1, 3), np.nan)]).astype(np.float32)
    mask = jnp.arange(N + 21) < N
    result = adaptive_filter(PointCloud(jnp.asarray(padded), mask.at[-1].set(True)), order=order, **SETTINGS)
    alone = adaptive_filter(exact(points), order=order, **SETTINGS)
    np.testing.assert_allclose(result.xyz[:N], alone.xyz, atol=1e-4)
    np.testing.assert_array_equal(result.xyz[N:], padded[N:])
    np.testing.assert_array_equal(np.asarray(result.status[N:]), [0] * 20 + [Status.NOT_FINITE])
    assert (np.asarray(result.width)[N:] == 0).all()


@pytest.mark.parametrize(("radius", "noise"), [(15.0, 0.385), (2.5, 0.05), (60.0, 0.1)])
def test_order_two_keeps_the_diameter_and_order_zero_does_not(radius, noise):
    points = half_cylinder(2000, radius=radius, noise=noise, length=1.5 * radius)
    cloud = PointCloud.from_xyz(points)
    xyz = [np.asarray(adaptive_filter(cloud, order=o).xyz, dtype=np.float64)[:2000] for o in (0, 2)]
    inside = (points[:, 2] > 0.2 * radius) & (points[:, 2] < 1.3 * radius) & (points[:, 1] > 0.3 * radius)
    shrunk, kept = ((np.hypot(p[:, 0], p[:, 1]) - radius)[inside] for p in xyz)
    # The mean of the noise itself over the points inside is unknown to sigma / sqrt(n): three of those.
    sampling = 3 * noise / np.sqrt(inside.sum())
    assert abs(kept.mean()) < sampling + 0.05 * noise
    assert abs(kept.mean()) < 0.2 * abs(shrunk.mean())
    assert kept.std() < 0.4 * noise


def test_vmap_equals_loop_and_does_not_retrace():
    traces = []

    @jax.jit
    def batched(xyz):
        traces.append(1)
        return jax.vmap(lambda x: adaptive_filter(PointCloud(x, jnp.ones(N, dtype=bool)), order=2, **SETTINGS).xyz)(xyz)

    clouds = jnp.stack([cloud(seed=1).xyz, cloud(seed=2).xyz])
    together = batched(clouds)
    for i in range(2):
        single = adaptive_filter(PointCloud(clouds[i], jnp.ones(N, dtype=bool)), order=2, **SETTINGS).xyz
        np.testing.assert_allclose(together[i], single, atol=1e-4)
    batched(clouds + 1.0)
    assert len(traces) == 1


@pytest.mark.parametrize("order", [0, 2])
def test_gradients_are_finite(order):
    points = cloud(n=120)
    points = PointCloud(points.xyz.at[3].set(points.xyz[4]), points.mask.at[0].set(False))
    gradient = jax.jit(
        jax.grad(lambda x: jnp.sum(jnp.square(adaptive_filter(PointCloud(x, points.mask), k=16, order=order).xyz)))
    )
    assert np.isfinite(np.asarray(gradient(points.xyz))).all()


@pytest.mark.parametrize("name", ["one point", "all equal", "line"])
@pytest.mark.parametrize("order", [0, 2])
def test_degenerate_clouds_stay_finite_and_in_place(name, order):
    line = np.outer(np.arange(60.0), [1, 0, 0])
    xyz = {"one point": np.ones((1, 3)), "all equal": np.ones((60, 3)), "line": line}[name]
    result = adaptive_filter(PointCloud.from_xyz(xyz, capacity=N), order=order, **SETTINGS)
    interior = slice(16, -16) if name == "line" else slice(None)
    np.testing.assert_allclose(np.asarray(result.xyz)[: len(xyz)][interior], xyz[interior], atol=1e-2)


def test_quadric_is_recovered_exactly():
    rng = np.random.default_rng(5)
    u, v = rng.uniform(-1, 1, (2, 40))
    points = jnp.asarray(np.stack([u, v, 0.02 + 0.1 * u * u - 0.05 * u * v + 0.08 * v * v]), dtype=jnp.float32)

    def sample(rows, near):
        return near.astype(jnp.float32), points[:, rows]

    fit = jax.jit(lambda: fit_surface(sample, jnp.arange(40)[:, None], order=2))()
    assert float(fit.noise[0]) < 0.03
    # The normal is that of the best plane, not quite z: heights along it shrink by its cosine.
    np.testing.assert_allclose(jnp.abs(fit.height * fit.normal[2]), 0.02, atol=5e-3)


def test_least_axis_equals_eigh():
    rng = np.random.default_rng(6)
    root = rng.normal(size=(200, 3, 3)) * [1.0, 1.0, 0.2]
    matrix = root @ root.transpose(0, 2, 1)
    value, axes = np.linalg.eigh(matrix)
    apart = value[:, 1] > 1.3 * value[:, 0]
    six = [matrix[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    axis, least = jax.jit(least_axis)(jnp.asarray(np.stack(six), dtype=jnp.float32))
    cosine = np.abs(np.sum(np.asarray(axis).T * axes[:, :, 0], axis=1))
    assert (cosine[apart] > 1 - 1e-4).all()
    # v' C v in float32 next to eigenvalues up to 30 times as large.
    np.testing.assert_allclose(least[apart], value[apart, 0], atol=1e-5 * value.max())


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"k": 0}, "k: expected at least 1, got 0"),
        ({"order": 3}, "order: expected 0, 1 or 2, got 3"),
        ({"form": "cubic"}, "form: expected"),
        ({"iterations": 0}, "iterations: expected at least 1, got 0"),
        ({"refinements": -1}, "refinements: expected at least 0, got -1"),
        ({"found": KnnResult(np.zeros((3, 1), int), np.zeros((3, 1)), np.zeros(3, int))}, "found: expected 20 rows"),
    ],
)
def test_bad_arguments_are_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        adaptive_filter(cloud(n=20), **kwargs)


def test_neighbours_found_before_are_the_same():
    points = cloud()
    found = knn(points.xyz, k=16, mask=points.mask)
    searched = adaptive_filter(points, order=0, **SETTINGS)
    given = adaptive_filter(points, order=0, found=found, **SETTINGS)
    np.testing.assert_array_equal(given.xyz, searched.xyz)


def test_the_width_follows_the_noise_and_the_curvature():
    widths = [
        np.median(adaptive_filter(PointCloud.from_xyz(half_cylinder(2000, radius=r, noise=s)), order=2).width[:2000])
        for r, s in ((7.5, 0.385), (7.5, 0.8), (30.0, 0.385))
    ]
    assert widths[1] > 1.1 * widths[0]
    assert widths[2] > 1.1 * widths[0]
