"""Rigid motions against SciPy, against their group laws, and in the degenerate cases of Kabsch's method."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from cablejax.ops.rigid import compose, invert, kabsch, se3_exp, se3_log, skew, so3_log, transform

EXP = jax.jit(se3_exp)
LOG = jax.jit(se3_log)
KABSCH = jax.jit(kabsch)
RNG = np.random.default_rng(7)
ANGLES = [0.0, 1e-8, 1e-4, 1e-2, 0.3, 0.499, 0.501, 1.0, 3.0, 3.14159]


def twist_of(angle: float) -> np.ndarray:
    axis = RNG.normal(size=3)
    return np.concatenate([RNG.normal(size=3), angle * axis / np.linalg.norm(axis)]).astype(np.float32)


def matrix_exponential(twist: np.ndarray) -> np.ndarray:
    """The definition: the power series of the 4 x 4 generator, summed by SciPy in float64."""
    x, y, z = twist[3:].astype(float)
    generator = np.array([[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0, 0, 0, 0]], dtype=float)
    return expm(generator)


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_is_the_matrix_exponential(angle):
    twist = twist_of(angle)
    # Entries are of order one (translations of a few): a few float32 roundings of 6e-8 each.
    np.testing.assert_allclose(EXP(jnp.asarray(twist)), matrix_exponential(twist), atol=2e-6)


@pytest.mark.parametrize("angle", ANGLES)
def test_logarithm_inverts_the_exponential(angle):
    twist = twist_of(angle)
    # Near half a turn the inverse of the left Jacobian is of order pi/2; roundings of 1e-7 grow little.
    np.testing.assert_allclose(LOG(EXP(jnp.asarray(twist))), twist, atol=1e-5)


def test_logarithm_at_half_a_turn_has_length_pi():
    for axis in np.eye(3):
        rotation = Rotation.from_rotvec(np.pi * axis).as_matrix().astype(np.float32)
        vector = so3_log(jnp.asarray(rotation))
        np.testing.assert_allclose(np.abs(vector), np.pi * axis, atol=1e-5)


def test_group_laws():
    a, b, c = (EXP(jnp.asarray(twist_of(angle))) for angle in (0.3, 1.2, 2.5))
    np.testing.assert_allclose((a @ b) @ c, a @ (b @ c), atol=1e-5)
    np.testing.assert_allclose(a @ invert(a), np.eye(4), atol=1e-6)
    points = jnp.asarray(RNG.normal(size=(5, 3)), dtype=jnp.float32)
    np.testing.assert_allclose(transform(a, transform(b, points)), transform(a @ b, points), atol=1e-5)


def test_skew_is_the_cross_product():
    v, w = RNG.normal(size=(2, 3)).astype(np.float32)
    np.testing.assert_allclose(skew(jnp.asarray(v)) @ jnp.asarray(w), np.cross(v, w), atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.0])
def test_gradients_are_finite_and_right(angle):
    twist = jnp.asarray(twist_of(angle))
    jacobian = jax.jit(jax.jacobian(lambda t: se3_log(se3_exp(t))))(twist)
    np.testing.assert_allclose(jacobian, np.eye(6), atol=1e-4)


def test_kabsch_agrees_with_scipy_on_noisy_weighted_pairs():
    source = RNG.normal(size=(200, 3)) * 30
    motion = matrix_exponential(twist_of(1.1))
    target = source @ motion[:3, :3].T + motion[:3, 3] + 0.1 * RNG.normal(size=source.shape)
    weights = RNG.uniform(0.1, 2, size=200)
    mean_s, mean_t = np.average(source, axis=0, weights=weights), np.average(target, axis=0, weights=weights)
    expected, _ = Rotation.align_vectors(target - mean_t, source - mean_s, weights=weights)
    got = KABSCH(
        *(jnp.asarray(a, dtype=jnp.float32) for a in (source, target)), weights=jnp.asarray(weights, jnp.float32)
    )
    np.testing.assert_allclose(got[:3, :3], expected.as_matrix(), atol=2e-6)
    # The translation carries the rotation's rounding, 1e-6, times coordinates of 100.
    np.testing.assert_allclose(got[:3, 3], mean_t - expected.as_matrix() @ mean_s, atol=2e-4)


def test_kabsch_gives_a_rotation_for_a_mirrored_set():
    source = jnp.asarray(RNG.normal(size=(50, 3)), jnp.float32)
    rotation = KABSCH(source, source * jnp.array([[1.0, 1.0, -1.0]]))[:3, :3]
    assert float(jnp.linalg.det(rotation)) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("kind", ["plane", "line", "point"])
def test_kabsch_on_degenerate_sets_is_a_rotation_that_fits(kind):
    source = RNG.normal(size=(40, 3)) * {"plane": [1, 1, 0], "line": [1, 0, 0], "point": [0, 0, 0]}[kind]
    motion = matrix_exponential(twist_of(0.8))
    target = source @ motion[:3, :3].T + motion[:3, 3]
    got = KABSCH(jnp.asarray(source, jnp.float32), jnp.asarray(target, jnp.float32))
    np.testing.assert_allclose(got[:3, :3] @ got[:3, :3].T, np.eye(3), atol=1e-5)
    assert float(jnp.linalg.det(got[:3, :3])) == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(transform(got, jnp.asarray(source, jnp.float32)), target, atol=1e-5)


def test_weights_of_zero_are_padding():
    source = jnp.asarray(RNG.normal(size=(20, 3)), jnp.float32)
    target = transform(EXP(jnp.asarray(twist_of(0.5))), source)
    padded = jnp.pad(source, ((0, 5), (0, 0)), constant_values=99.0)
    weights = (jnp.arange(25) < 20).astype(jnp.float32)
    got = KABSCH(padded, jnp.pad(target, ((0, 5), (0, 0)), constant_values=-50.0), weights=weights)
    np.testing.assert_allclose(got, KABSCH(source, target), atol=2e-6)


def test_vmap_is_a_loop():
    twists = jnp.asarray(np.stack([twist_of(angle) for angle in (0.0, 0.2, 2.0)]))
    np.testing.assert_allclose(jax.vmap(se3_exp)(twists), jnp.stack([EXP(t) for t in twists]), atol=1e-6)


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"target: expected the shape of source, \[3, 3\], got \[2, 3\]"):
        kabsch.__wrapped__(jnp.zeros((3, 3)), jnp.zeros((2, 3)))


def test_compose_keeps_the_last_row():
    assert compose(jnp.eye(3), jnp.ones(3))[3].tolist() == [0, 0, 0, 1]
