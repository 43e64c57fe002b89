"""The weighted cylinder fit: what it finds, its laws, its uncertainty, its gradient."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import weighted_cylinder
from cablejax.ops.weighted_cylinder import principal_axes
from cablejax.types import Status

N = 256
fit = jax.jit(weighted_cylinder)
graded = jax.jit(jax.value_and_grad(lambda weight, xyz: weighted_cylinder(xyz, weight, iterations=40).radius))


def piece(radius=12.0, arc_deg=100.0, noise=0.2, bend_mm=900.0, seed=0, strays=0):
    """Points of a bent piece of cable seen from one side, in a random pose; the last `strays` are a wall beside it."""
    rng = np.random.default_rng(seed)
    count = N - strays
    turn = np.radians(rng.uniform(-arc_deg / 2, arc_deg / 2, count))
    r, arc = radius + rng.normal(0, noise, count), rng.uniform(-80, 80, count) / bend_mm
    x, y = (bend_mm + r * np.sin(turn)) * np.sin(arc), (bend_mm + r * np.sin(turn)) * np.cos(arc) - bend_mm
    xyz = np.stack([x, y, r * np.cos(turn)], axis=1)
    wall = np.stack([rng.uniform(-80, 80, strays), rng.uniform(-60, 60, strays), np.full(strays, -30.0)], axis=1)
    frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return jnp.asarray(np.concatenate([xyz, wall]) @ frame.T, jnp.float32), jnp.arange(N) < count


@pytest.mark.parametrize("arc_deg", [90.0, 180.0, 360.0])
def test_the_radius_of_a_bent_piece(arc_deg):
    xyz, _ = piece(arc_deg=arc_deg, noise=0.0)
    found = fit(xyz, jnp.ones(N))
    assert int(found.status) == 0
    # the parabola is off the circle of 900 mm by its fourth order, 80^4 / (8 * 900^3) = 0.007 mm, and its tangent likewise
    assert float(found.radius) == pytest.approx(12.0, abs=0.03)


def test_points_without_weight_do_not_count():
    xyz, on_cable = piece(strays=80)
    weight = on_cable.astype(jnp.float32)
    plain = fit(xyz, weight)
    moved = fit(jnp.where(on_cable[:, None], xyz, 1e4), weight)
    assert abs(float(plain.radius) - 12.0) < 4 * float(plain.std)
    np.testing.assert_allclose(moved.radius, plain.radius, rtol=1e-5)
    assert abs(float(fit(xyz, jnp.ones(N)).radius) - 12.0) > 10 * float(plain.std)  # the wall spoils an even fit


def test_the_standard_deviation_is_that_of_repeated_scans():
    found = [fit(piece(seed=seed)[0], jnp.ones(N)) for seed in range(60)]
    off = np.array([float(each.radius) - 12.0 for each in found])
    claimed = np.sqrt(np.mean([float(each.std) ** 2 for each in found]))
    # 60 draws tell a standard deviation to 9 %; three of these
    assert 0.73 < np.sqrt(np.mean(off**2)) / claimed < 1.27


def test_laws():
    xyz, on_cable = piece(strays=60)
    weight = jnp.where(on_cable, 0.9, 0.02)
    found = fit(xyz, weight)
    order = np.random.default_rng(1).permutation(N)
    np.testing.assert_allclose(fit(xyz[order], weight[order]).radius, found.radius, rtol=1e-4)
    np.testing.assert_allclose(fit(xyz + 300.0, weight).radius, found.radius, rtol=1e-4)
    np.testing.assert_allclose(fit(3.0 * xyz, weight).radius, 3.0 * found.radius, rtol=1e-4)
    np.testing.assert_allclose(fit(xyz, 0.5 * weight).radius, found.radius, rtol=1e-4)


def test_the_gradient_is_that_of_the_minimum():
    xyz, on_cable = piece(strays=40, arc_deg=140.0)
    weight = jnp.where(on_cable, 0.9, 0.1)

    gradient = np.asarray(graded(weight, xyz)[1])
    assert np.isfinite(gradient).all()
    assert np.abs(gradient).max() > 1e-4
    # Along a direction of many weights, so that float32's differences say something. The robust weights and the frame count
    # as fixed in the gradient, which leaves it a quarter off at most here.
    direction = np.sign(gradient) * np.asarray(on_cable)
    step = 0.05
    slope = (graded(weight + step * direction, xyz)[0] - graded(weight - step * direction, xyz)[0]) / (2 * step)
    assert float(slope) == pytest.approx(float(gradient @ direction), rel=0.25)


def test_a_known_radius_leaves_the_axis_to_be_fitted():
    xyz, _ = piece(noise=0.0, arc_deg=180.0)
    known = jax.jit(lambda r: weighted_cylinder(xyz, jnp.ones(N), radius=r))
    right, wrong = known(12.0), known(15.0)
    assert float(right.radius) == pytest.approx(12.0, rel=1e-5)
    assert float(wrong.radius) == pytest.approx(15.0, rel=1e-5)
    assert float(wrong.noise) > 20 * float(right.noise)


@pytest.mark.parametrize("weight", [0.0, 1e-9])
def test_without_points_there_is_no_cylinder_and_no_nan(weight):
    xyz, _ = piece()
    value, gradient = graded(jnp.full(N, weight), xyz)
    found = fit(xyz, jnp.full(N, weight))
    assert bool(found.status & int(Status.DEGENERATE))
    assert bool(found.status & int(Status.EMPTY)) == (weight == 0.0)
    assert float(value) == 0.0
    assert np.isfinite(np.asarray(gradient)).all()
    assert all(np.isfinite(np.asarray(each)).all() for each in found)


def test_a_flat_side_has_a_radius_that_its_noise_belies():
    rng = np.random.default_rng(0)
    flat = np.stack([rng.uniform(-80, 80, N), rng.uniform(-30, 30, N), np.zeros(N)], axis=1)
    found = fit(jnp.asarray(flat, jnp.float32), jnp.ones(N))
    assert int(found.status) == int(Status.DEGENERATE) or found.noise > 0.4 * found.radius


def test_principal_axes_equal_those_by_eigenvectors():
    rng = np.random.default_rng(0)
    xyz = rng.gamma(2.0, size=(N, 3)) * [60.0, 20.0, 5.0]
    weight = rng.uniform(0, 1, N)
    _, rotation = jax.jit(principal_axes)(jnp.asarray(xyz, jnp.float32), jnp.asarray(weight, jnp.float32))
    centred = xyz - np.average(xyz, axis=0, weights=weight)
    _, vectors = np.linalg.eigh((centred * weight[:, None]).T @ centred)
    np.testing.assert_allclose(np.abs(np.sum(np.asarray(rotation) * vectors[:, ::-1].T, axis=1)), 1.0, atol=1e-4)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)
    assert np.linalg.det(np.asarray(rotation)) > 0
