"""The network that labels points, and the labels of a whole scan."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.nets import PartNetwork, label_parts, labelling
from cablejax.nets.part_network import LOCAL_MM, local_shape

N = 96


@pytest.fixture(scope="module")
def network() -> PartNetwork:
    model = PartNetwork(3, k=8, widths=(8, 8), shared_width=16, head=(16,), rngs=nnx.Rngs(0))
    model.eval()
    return model


@pytest.fixture(scope="module")
def cloud() -> tuple[jax.Array, jax.Array]:
    xyz = np.random.default_rng(0).normal(size=(2, N, 3)) * [60, 20, 10]
    return jnp.asarray(xyz, jnp.float32), jnp.arange(N)[None, :] < jnp.asarray([[N], [N - 20]])


def test_a_label_a_point_whatever_the_order_the_padding_and_the_pose(network, cloud):
    xyz, mask = cloud
    logits = np.asarray(network(xyz, mask))
    assert logits.shape == (2, N, 3)
    order = np.random.default_rng(1).permutation(N)
    np.testing.assert_allclose(network(xyz[:, order], mask[:, order]), logits[:, order], atol=2e-4)
    other = jnp.where(mask[..., None], xyz, 1e3)
    np.testing.assert_allclose(np.asarray(network(other, mask))[1, : N - 20], logits[1, : N - 20], atol=1e-5)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    turn = turn * np.sign(np.linalg.det(turn))
    moved = np.asarray(network(jnp.asarray(xyz @ turn.T + 7.0, jnp.float32), mask))
    np.testing.assert_allclose(moved[0], logits[0], atol=2e-3)


def test_padding_does_not_count_in_training_statistics(cloud):
    xyz, mask = cloud
    logits = []
    for filler in (0.0, 500.0):
        model = PartNetwork(3, k=8, widths=(8, 8), shared_width=16, head=(16,), rngs=nnx.Rngs(0))
        model.train()
        logits.append(np.asarray(model(jnp.where(mask[..., None], xyz, filler), mask))[1, : N - 20])
    np.testing.assert_allclose(logits[0], logits[1], atol=1e-5)


def test_local_shape_tells_flat_from_round():
    rng = np.random.default_rng(0)
    along, aside = rng.uniform(-30, 30, 600), rng.uniform(-30, 30, 600)
    flat = np.stack([along, aside, 0 * along], axis=1)
    turn = aside / 15
    round_ = np.stack([along, 15 * np.sin(turn), 15 * np.cos(turn)], axis=1)
    mask = jnp.ones(600, bool)
    thick = [float(np.median(local_shape(jnp.asarray(xyz, jnp.float32), mask)[:, 4])) for xyz in (flat, round_)]
    assert LOCAL_MM * thick[0] < 0.05
    # 32 points lie within some 4.3 mm: heights of a sphere cap's width squared over the diameter
    assert LOCAL_MM * thick[1] > 0.12
    assert not np.asarray(local_shape(jnp.asarray(flat, jnp.float32), ~mask)).any()


def test_the_number_of_parts_is_checked():
    with pytest.raises(ValueError, match="num_classes: expected 2 or more, got 1"):
        PartNetwork(1, rngs=nnx.Rngs(0))


class ByThickness(nnx.Module):
    """Flat or not, by the thickness of a point's own neighbourhood."""

    def __call__(self, xyz, mask):
        thick = jax.vmap(local_shape)(xyz, mask)[..., 4]
        return jnp.stack([jnp.full_like(thick, 0.2), 20 * thick - 1.0], axis=-1)


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray]:
    """A ball's surface far from a floor 700 mm long, and which points are the ball's."""
    rng = np.random.default_rng(0)
    floor = np.stack([rng.uniform(0, 700, 5000), rng.uniform(0, 100, 5000), np.zeros(5000)], axis=1)
    ball = rng.normal(size=(500, 3))
    ball = 12 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [350, 50, 60]
    xyz = np.concatenate([floor, ball])
    order = rng.permutation(len(xyz))
    return xyz[order] + [5e5, 4e6, 100.0], order >= 5000


def test_every_point_of_a_long_scan_is_labelled(scene):
    xyz, is_ball = scene
    holed = np.concatenate([xyz, np.full((3, 3), np.nan)])
    found = label_parts(ByThickness(), holed, n_points=512, ball_mm=100.0)
    assert (found.part[:-3] == is_ball).mean() > 0.97
    assert (found.part[-3:] == -1).all()
    assert np.isnan(found.probability[-3:]).all()
    np.testing.assert_allclose(found.probability[:-3].sum(axis=1), 1.0)
    again = label_parts(ByThickness(), holed, n_points=512, ball_mm=100.0)
    np.testing.assert_array_equal(found.part, again.part)


def test_of_very_many_points_the_rest_takes_the_label_of_the_nearest(scene, monkeypatch):
    xyz, is_ball = scene
    monkeypatch.setattr(labelling, "MOST_POINTS", 4000)
    assert (label_parts(ByThickness(), xyz, n_points=512, ball_mm=100.0).part == is_ball).mean() > 0.97


def test_fewer_points_than_the_network_takes_are_padded():
    xyz = np.random.default_rng(0).uniform(0, 50, (40, 3))
    assert label_parts(ByThickness(), xyz, n_points=128).part.shape == (40,)


def test_a_scan_without_points_is_refused():
    with pytest.raises(ValueError, match="xyz_mm: expected at least one point, got none"):
        label_parts(ByThickness(), np.full((4, 3), np.nan))
