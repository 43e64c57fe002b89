"""Scores of many cylinders at once are those of one after the other."""

import numpy as np
import pytest

from cablejax.measure.find.cylinder import Cylinder
from cablejax.measure.find.hypotheses import AT_ONCE, rough_scores, score, tolerance_of
from cablejax.measure.find.surface import Surface
from tests.reference.circles import bent_cable


@pytest.mark.parametrize("away", [0.0, 1e3])
def test_rough_scores_are_the_scores(away):
    rng = np.random.default_rng(3)
    xyz = bent_cable(radius=12.0, n=700, arc_deg=220.0, noise=0.1, seed=1)
    normals = xyz * [0, 1, 1]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    sample = Surface(xyz + away, normals, roughness_mm=0.2, spacing_mm=1.0, reach_mm=5.0)
    guesses = []
    for radius in rng.uniform(3.0, 20.0, 2 * AT_ONCE + 5):
        direction = np.array([1.0, 0.0, 0.0]) + rng.normal(0, 0.2, 3)
        direction = direction / np.linalg.norm(direction)
        guesses.append(
            Cylinder(sample.xyz[rng.integers(700)] * [1, 0, 0] + away * np.array([0, 1, 1]), direction, radius)
        )
    guesses.append(Cylinder(np.full(3, away + 900.0), guesses[0].direction, 12.0))  # with nothing near
    expected = [score(sample, guess, tolerance_of(sample, guess.radius_mm))[0] for guess in guesses]
    found = rough_scores(sample, guesses)
    assert np.count_nonzero(expected) > AT_ONCE
    assert found[-1] == expected[-1] == 0.0
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-4)


def test_no_guesses_have_no_scores():
    sample = Surface(np.zeros((20, 3)), np.zeros((20, 3)), 0.1, 1.0, 1.0)
    assert rough_scores(sample, []).shape == (0,)
