"""Covariances of neighbourhoods and the planes through them, against NumPy."""

import numpy as np
import pytest

from cablejax.geometry.normals import (
    covariances_nearest,
    covariances_within,
    fitted_planes,
    least_direction,
    plain_tree,
)

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def test_covariances_are_those_of_the_surroundings():
    rng = np.random.default_rng(0)
    lonely = [[3.0, 0.0, 0.0], [3.1, 0.1, 0.0]]
    xyz = np.concatenate([rng.uniform(size=(400, 3)), lonely]) + 1e6  # far from the origin
    found = covariances_within(xyz, plain_tree(xyz), radius=0.2, least=4, k=6)
    for row in (0, 7, 400):
        distance = np.linalg.norm(xyz - xyz[row], axis=1)
        near = distance <= 0.2 if (distance <= 0.2).sum() >= 4 else np.argsort(distance)[:6]
        expected = np.cov(xyz[near].T, bias=True)
        np.testing.assert_allclose(found[row], [expected[i, j] for i, j in ENTRIES], atol=1e-8)
    np.testing.assert_allclose(found[400:], covariances_nearest(xyz, plain_tree(xyz), k=6)[400:], atol=1e-12)


def test_normals_are_the_eigenvectors():
    rng = np.random.default_rng(0)
    flat = rng.normal(size=(200, 3)) * [1.0, 0.5, 1e-3]
    line = rng.normal(size=(50, 1)) * np.array([[1.0, 2.0, 3.0]])  # the closed form has no answer there
    for xyz in (flat, line):
        matrix = np.cov(xyz.T)
        covariance = np.array([[matrix[i, j] for i, j in ENTRIES]])
        found = least_direction(covariance)[0]
        assert np.linalg.norm(found) == pytest.approx(1)
        assert np.linalg.norm(matrix @ found) == pytest.approx(np.linalg.eigvalsh(matrix)[0], abs=1e-9)


def test_planes_are_those_that_noise_was_put_on():
    rng = np.random.default_rng(0)
    xyz = np.concatenate([rng.uniform(-1, 1, size=(2000, 2)), 1e-3 * rng.normal(size=(2000, 1))], axis=1)
    normal, std = fitted_planes(np.cov(xyz.T, bias=True)[tuple(np.array(ENTRIES).T)][None])
    np.testing.assert_allclose(np.abs(normal[0]), [0, 0, 1], atol=1e-3)
    assert std[0] == pytest.approx(1e-3, rel=0.1)  # six times the standard error of a standard deviation
