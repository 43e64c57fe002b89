"""The dataset: balanced, disjoint, at metric scale, the same bytes for the same seed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import DatasetConfig, make_split, make_tube, sample_clouds
from cablejax.simulate.clouds import SHARES, STRATA, stratified, surrounded
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


def test_free_pose_is_the_canonical_one_turned():
    free = make_split(dataclasses.replace(SMALL, canonical_pose=False), "test")
    canonical = make_split(SMALL, "test")
    assert free.xyz.tobytes() != canonical.xyz.tobytes()

    def spread(xyz):  # what no rotation changes
        return np.linalg.eigvalsh(np.einsum("bni,bnj->bij", *[np.asarray(xyz, np.float64)] * 2) / 128)

    # coordinates of 100 mm are known to 1e-5 mm, their squares to 2e-3 of up to 5,000 mm2
    assert np.allclose(spread(free.xyz), spread(canonical.xyz), rtol=1e-5, atol=0.01)
    along = np.asarray(canonical.xyz).std(axis=1)
    assert (along[:, 0] > along[:, 1]).all()
    assert (along[:, 0] > along[:, 2]).all()
    # free poses point anywhere: of nine axes, not all within 45 degrees of x
    _, axes = np.linalg.eigh(np.einsum("bni,bnj->bij", *[np.asarray(free.xyz, np.float64)] * 2))
    assert (np.abs(axes[:, 0, 2]) < 0.7).any()


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


def scene_numbers(share, count=400):
    """Walls' distance and the other cables' gap from the sheath, and their angle off the view, of many scenes."""
    tube = make_tube("bend", diameter_mm=30.0, length_mm=200.0, bend_radius_mm=700.0)
    middle = jnp.float32(2.0)

    def one(u):
        scene = surrounded(tube, middle, jnp.float32(share), u)
        wall, other = scene.solids
        across = jnp.append(other.tube.centreline.at(jnp.float32(100.0))[0], 0.0) + other.shift_mm
        gap = jnp.linalg.norm(across) - 15.0 - other.tube.radius_mm
        return -wall.level_mm - 15.0, gap, jnp.arctan2(across[2], across[1]) - middle, other.tube.radius_mm

    return [np.asarray(x) for x in jax.jit(jax.vmap(one))(jax.random.uniform(jax.random.key(1), (count, 6)))]


def test_clutter_stands_where_it_is_said_to():
    wall, gap, off, radius = scene_numbers(0.5)
    # 400 draws know a share of a half to 0.025; three of those
    assert np.mean(wall < 1e3) == pytest.approx(0.5, abs=0.075)
    assert np.mean(gap < 1e3) == pytest.approx(0.5, abs=0.075)
    there = gap < 1e3
    assert 12 <= wall[wall < 1e3].min() < 16
    assert 55 < wall[wall < 1e3].max() <= 60
    assert 1 <= gap[there].min() + 1e-3 < 1.5
    assert 9.5 < gap[there].max() <= 10 + 1e-3
    aside = np.abs(np.degrees(np.arctan2(np.sin(off), np.cos(off))))[there]
    assert aside.min() > 44.9
    assert aside.max() < 135.1
    assert 8.9 < radius.min() < radius.max() < 21.1
    nothing, none, _, _ = scene_numbers(0.0)
    assert min(nothing.min(), none.min()) > 1e3


def test_hard_clouds_hold_clutter_within_the_working_range():
    config = DatasetConfig(sizes_mm2=(25, 240), n_points=128, clouds_per_class=32, version="hard")
    split = make_split(config, "train")
    assert bool(jnp.isfinite(split.xyz).all())
    assert float(split.mask.mean()) > 0.99
    reach = np.asarray(jnp.linalg.norm(split.xyz, axis=2))
    assert reach.max() < 4 * 500
    # a cable by itself keeps 9 points in 10 within a radius and some of its axis, the direction of largest variance;
    # three clouds in four have a wall or another cable
    across = np.asarray(jnp.linalg.norm(split.xyz[:, :, 1:], axis=2))
    wide = np.quantile(across, 0.8, axis=1) > 0.75 * np.asarray(split.diameter_mm)
    assert 0.3 < wide.mean() < 0.95


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
