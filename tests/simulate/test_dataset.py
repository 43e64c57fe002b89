"""The dataset: balanced, disjoint, at metric scale, the same bytes for the same seed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import DatasetConfig, make_split, sample_clouds
from cablejax.simulate.clouds import SHARES, STRATA, stratified
from cablejax.simulate.pose import canonical_pose, rotation_of

SMALL = DatasetConfig(sizes_mm2=(25, 240, 630), n_points=128, clouds_per_class=3, version="standard")


@pytest.fixture(scope="module")
def splits():
    return {name: make_split(SMALL, name) for name in ("train", "validation", "test")}


def test_classes_are_balanced_and_points_centred(splits):
    for split in splits.values():
        assert split.xyz.shape == (9, 128, 3)
        assert np.bincount(split.label).tolist() == [3, 3, 3]
        assert bool(split.mask.all())
        assert float(jnp.abs(split.xyz.mean(axis=1)).max()) < 1e-3


def test_splits_share_no_point(splits):
    points = np.concatenate([np.asarray(split.xyz).reshape(-1, 3) for split in splits.values()])
    assert len(np.unique(points, axis=0)) == len(points)


def test_same_seed_same_bytes(splits):
    again = make_split(SMALL, "train")
    assert all(a.tobytes() == b.tobytes() for a, b in zip(splits["train"], again, strict=True))
    other = make_split(DatasetConfig(**{**vars(SMALL), "seed": 1}), "train")
    assert other.xyz.tobytes() != again.xyz.tobytes()


def test_more_clouds_begin_with_the_same_ones(splits):
    more = make_split(DatasetConfig(**{**vars(SMALL), "clouds_per_class": 30}), "train")
    assert more.xyz[:9].tobytes() == splits["train"].xyz.tobytes()


def test_clean_clouds_have_the_nominal_diameter_at_metric_scale():
    config = DatasetConfig(sizes_mm2=(25, 630), n_points=128, clouds_per_class=4, version="clean")
    split = make_split(config, "test")
    assert np.allclose(split.diameter_mm, np.array([21.3, 45.6])[split.label])
    # x is the estimated axis: its tilt, and the bend, widen the extent across it by some mm, towards larger alone
    across = np.asarray(jnp.ptp(split.xyz[:, :, 1:], axis=1)).min(axis=1)
    excess = across - np.asarray(split.diameter_mm)
    assert np.median(np.abs(excess)) < 2
    assert excess.max() < 10


def test_strata_of_the_splits_do_not_overlap():
    u = jnp.linspace(0, 1, 4001)[:-1]
    places = [np.asarray(stratified(u, split)) for split in range(3)]
    for place, (low, high) in zip(places, SHARES, strict=True):
        within = place * STRATA % 1
        # a float32 next to 20 is known to 1e-6, so a border may be missed by that
        assert within.min() >= low - 2e-6 or within.max() > 1 - 2e-6
        inside = (within > low - 2e-6) & (within < high + 2e-6)
        assert inside.mean() > 0.99


def test_rotation_is_a_rotation():
    q = jax.random.normal(jax.random.key(2), (4,))
    rotation = np.asarray(rotation_of(q))
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-6)


def test_canonical_pose_undoes_a_rotation():
    key = jax.random.key(5)
    cloud = jax.random.gamma(key, 2.0, (200, 3)) * jnp.array([[9.0, 3.0, 1.0]])
    mask = jnp.arange(200) < 180
    turned = cloud @ rotation_of(jax.random.normal(key, (4,))).T + 50.0
    first, second = canonical_pose(cloud, mask), canonical_pose(turned, mask)
    # coordinates of about 100 mm are known to 1e-5 mm; eigenvectors add a few roundings times the extent
    assert np.allclose(first[:180], second[:180], atol=5e-3)
    lengths = np.linalg.norm(np.diff(np.asarray(cloud)[:180], axis=0), axis=1)
    assert np.allclose(np.linalg.norm(np.diff(np.asarray(first)[:180], axis=0), axis=1), lengths, atol=1e-3)


def test_fresh_clouds_are_balanced_and_differ_by_key():
    first = sample_clouds(SMALL, 64, key=jax.random.key(0))
    second = sample_clouds(SMALL, 64, key=jax.random.key(1))
    assert sorted(np.bincount(first.label).tolist()) == [21, 21, 22]
    assert first.xyz.shape == (64, 128, 3)
    both = np.concatenate([first.xyz, second.xyz]).reshape(-1, 3)
    assert len(np.unique(both, axis=0)) == len(both)


@pytest.mark.parametrize(
    ("field", "value"),
    [("sizes_mm2", (25, 26)), ("n_points", 3), ("clouds_per_class", 0), ("version", "easy"), ("voltage", "1/3")],
)
def test_refuses(field, value):
    with pytest.raises(ValueError, match=f"^{field}: expected"):
        DatasetConfig(**{field: value})


def test_refuses_an_unknown_split():
    with pytest.raises(ValueError, match="split: expected one of train, validation, test, got 'dev'"):
        make_split(SMALL, "dev")
