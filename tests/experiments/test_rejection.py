"""What the comparison of fits and adgcnn_fit is made of."""

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import Split
from experiments.rejection import arcs_deg, most_likely, reliability, sizes_told

NOMINAL = (24.0, 30.0, 36.0)
N = 200


@pytest.fixture(scope="module")
def split() -> Split:
    """Pieces of each size seen over 90, 140 and 90 degrees, the last 60 rows a wall that is none of the cable."""
    rng = np.random.default_rng(0)
    clouds = []
    for diameter, arc in zip(NOMINAL, (90.0, 140.0, 90.0), strict=True):
        turn = np.radians(np.linspace(-arc / 2, arc / 2, N))[rng.permutation(N)]
        r = diameter / 2 + rng.normal(0, 0.05, N)
        xyz = np.stack([rng.uniform(-80, 80, N), r * np.cos(turn), r * np.sin(turn)], axis=1)
        xyz[-60:] = np.stack([rng.uniform(-80, 80, 60), np.full(60, -40.0), rng.uniform(-50, 50, 60)], axis=1)
        clouds.append(xyz)
    truth = jnp.broadcast_to(jnp.arange(N) < N - 60, (3, N))
    xyz = jnp.asarray(np.stack(clouds), jnp.float32)
    return Split(xyz, jnp.ones((3, N), bool), jnp.arange(3), jnp.asarray(NOMINAL), truth)


def test_the_likeliest_size_and_the_arc_of_the_true_points(split):
    arc, noise = arcs_deg(split)
    np.testing.assert_allclose(arc, [90, 140, 90], atol=6)
    np.testing.assert_allclose(noise, 0.05, rtol=0.4)
    np.testing.assert_array_equal(most_likely(split, NOMINAL, noise), [0, 1, 2])


def test_shares_that_are_told_rightly():
    found = sizes_told(np.array([0, 2, 5, -9]), np.array([0, 1, 1, 1]))
    assert found == {"accuracy": 0.25, "within_one": 0.5}


def test_reliability_counts_the_clouds_called_with_90_percent():
    rng = np.random.default_rng(0)
    sure = rng.uniform(0.5, 1.0, 4000)
    right = rng.uniform(size=4000) < sure  # a network that is as right as it is sure
    logits = np.log(np.stack([sure, 1 - sure], axis=1))
    found = reliability(logits, np.where(right, 0, 1))
    assert found["expected_calibration_error"] < 0.03  # ten bins of 400: each share is known to 0.025
    assert found["called_90"] == int(((sure >= 0.85) & (sure < 0.95)).sum())
    assert found["called_90_right"] / found["called_90"] == pytest.approx(0.9, abs=0.04)
    assert sum(each["clouds"] for each in found["bins"]) == 4000
    boastful = reliability(3 * logits, np.where(right, 0, 1))
    assert boastful["expected_calibration_error"] > 0.1
