"""Test-time sampling of a cable: what the network is shown, and that its say is averaged."""

import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.train import classify_cable

RNG = np.random.default_rng(0)
ALONG = RNG.uniform(0, 400, size=3000)
ANGLE = RNG.uniform(0, np.pi, size=3000)
XYZ = np.stack([ALONG, 15 * np.cos(ANGLE), 15 * np.sin(ANGLE)], axis=1) + 1e4


class Longest(nnx.Module):
    """Logits by the extent along x of each sample: how long a piece of the cable it was shown."""

    def __call__(self, xyz, mask):
        assert xyz.shape[1:] == (64, 3)
        extent = jnp.max(xyz[:, :, 0], axis=1) - jnp.min(xyz[:, :, 0], axis=1)
        return jnp.stack([jnp.zeros_like(extent), 0.1 * (extent - 150.0)], axis=1)


@pytest.mark.parametrize("canonical", [False, True])
def test_samples_are_pieces_of_the_length_asked_for(canonical):
    """64 points of a piece of 150 mm span some 145 of them, and never more: the second class then has less than a half."""
    short = classify_cable(Longest(), XYZ, ALONG, n_points=64, canonical=canonical)
    long = classify_cable(Longest(), XYZ, ALONG, n_points=64, canonical=canonical, piece_mm=300)
    assert short.sum() == pytest.approx(1)
    assert 0.1 < short[1] < 0.51
    assert long[1] > 0.99


def test_the_same_seed_gives_the_same():
    first, again, other = (
        classify_cable(Longest(), XYZ, ALONG, n_points=64, pieces=2, seed=seed) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_few_points_are_shown_again():
    found = classify_cable(Longest(), XYZ[:20], ALONG[:20], n_points=64)
    assert np.isfinite(found).all()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"xyz_mm": XYZ[:0], "along_mm": ALONG[:0]}, r"xyz_mm: expected points \[n, 3\]"),
        ({"along_mm": ALONG[:5]}, r"along_mm: expected shape \[3000\], got \[5\]"),
        ({"n_points": 0}, "n_points: expected a number above 0, got 0"),
        ({"pieces": 0}, "pieces: expected a number above 0, got 0"),
        ({"piece_mm": -1.0}, "piece_mm: expected a number above 0, got -1.0"),
    ],
)
def test_bad_input_is_named(change, told):
    with pytest.raises(ValueError, match=told):
        classify_cable.__wrapped__(Longest(), **{"xyz_mm": XYZ, "along_mm": ALONG, "n_points": 64, **change})
