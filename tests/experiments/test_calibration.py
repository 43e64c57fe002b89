"""One temperature by validation clouds: found where it is known, and what the calibrated network makes of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.nets import Calibrated
from cablejax.nets.pretrained import calibrated
from experiments.calibration import temperature_of, together
from experiments.rejection import reliability

CLASSES = 5


def said(n: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    """Logits of a network that is as right as it is sure, and labels drawn by them."""
    rng = np.random.default_rng(0)
    logits = 2.0 * rng.normal(size=(n, CLASSES))
    chance = np.asarray(jax.nn.softmax(logits, axis=1))
    label = (rng.random((n, 1)) > np.cumsum(chance, axis=1)).sum(axis=1)
    return logits, np.minimum(label, CLASSES - 1)


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_the_temperature_undoes_a_factor(factor: float):
    logits, label = said()
    found = temperature_of(factor * logits, label)
    # 20,000 clouds tell it to about a percent.
    assert found == pytest.approx(factor, rel=0.05)
    assert reliability(factor * logits / found, label)["expected_calibration_error"] < 0.02


class Fixed(nnx.Module):
    """Says the same of every cloud."""

    def __call__(self, xyz: jax.Array, mask: jax.Array) -> jax.Array:
        return jnp.broadcast_to(jnp.array([1.0, 3.0]), (xyz.shape[0], 2))


def test_a_card_with_a_temperature_calibrates_and_one_without_does_not():
    clouds = jnp.zeros((3, 4, 3)), jnp.ones((3, 4), bool)
    network = calibrated(Fixed(), {"temperature": 2.0})
    np.testing.assert_allclose(jax.jit(network)(*clouds), [[0.5, 1.5]] * 3)
    plain = Fixed()
    assert calibrated(plain, {}) is plain
    with pytest.raises(ValueError, match="temperature: expected a number above 0, got 0"):
        Calibrated(plain, 0.0)


def test_seeds_are_counted_together():
    row = {"called_90": 10, "called_90_right": 9}
    keys = [f"{name}_{when}" for name in ("validation", "test", "new") for when in ("before", "after")]
    found = together([dict.fromkeys(keys, row), {key: {"called_90": 30, "called_90_right": 27} for key in keys}])
    assert (found["new_after"]["called"], found["new_after"]["right"]) == (40, 36)
    assert found["new_after"]["interval_95"][0] < 0.9 < found["new_after"]["interval_95"][1]
