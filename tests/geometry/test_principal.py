"""Principal axes: turned with the points, also where one direction is a thousand millionth of another."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cablejax.geometry.principal import facing_up, principal_axes


def test_axes_turn_and_shift_with_the_points():
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(500, 3)) * [5.0, 2.0, 0.5]
    turned, shift = Rotation.random(random_state=1).as_matrix(), np.array([1e4, -3.0, 7.0])
    plain, moved = principal_axes(xyz), principal_axes(xyz @ turned.T + shift)
    np.testing.assert_allclose(moved.center, turned @ plain.center + shift, atol=1e-9)
    np.testing.assert_allclose(moved.std, plain.std, rtol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(moved.axes * (plain.axes @ turned.T), axis=1)), 1.0, atol=1e-9)
    assert moved.std[0] ** 2 == pytest.approx(np.linalg.eigvalsh(np.cov(xyz.T, bias=True))[-1])


def test_a_line_is_told_from_a_very_flat_strip():
    line = np.linspace(0, 1, 50)[:, None] * [1.0, 2.0, 3.0]
    strip = line + 1e-8 * np.random.default_rng(0).normal(size=(50, 3))
    assert principal_axes(line).std[1] < 1e-12 < 1e-9 < principal_axes(strip).std[1]


@pytest.mark.parametrize("direction", [[0.6, -0.8, 0.0], [-0.6, 0.8, 0.0]])
def test_either_sign_faces_up(direction):
    np.testing.assert_allclose(facing_up(np.array(direction)), [-0.6, 0.8, 0.0])
