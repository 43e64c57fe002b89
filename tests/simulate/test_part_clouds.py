"""Clouds whose points are labelled by part."""

import jax
import numpy as np
import pytest
from scipy.spatial import KDTree

from cablejax.simulate import PARTS, Part, PartsConfig, make_part_split
from cablejax.simulate.part_clouds import GROUP
from cablejax.simulate.part_scenes import WIDE_SCANNERS, draw_scene
from cablejax.simulate.presets import PRESETS
from tests.compiling import compiled_for_speed

CONFIG = PartsConfig(n_points=512, seed=3)


@pytest.fixture(scope="module")
def split():
    with compiled_for_speed():
        return make_part_split(CONFIG, "train", 32)


def test_every_label_of_the_simulator_has_a_group():
    assert [int(part) for part in Part] == list(range(len(GROUP)))
    assert set(GROUP) == set(range(len(PARTS)))
    assert GROUP[Part.OTHER_CABLE] == GROUP[Part.CABLE] == PARTS.index("cable")


def test_clouds_are_balls_of_points_that_are_all_there(split):
    xyz, mask = np.asarray(split.xyz), np.asarray(split.mask)
    assert xyz.shape == (32, 512, 3)
    assert np.isfinite(xyz).all()
    assert mask.sum(axis=1).min() > 20
    for cloud, valid in zip(xyz, mask, strict=True):
        assert np.linalg.norm(cloud[valid][:, None] - cloud[valid][None], axis=2).max() <= 2 * CONFIG.ball_mm + 0.1
        np.testing.assert_allclose(cloud[valid].mean(axis=0), 0, atol=1e-3)
        assert not cloud[~valid].any()


def test_all_parts_occur_and_strays_stand_apart(split):
    label, mask = np.asarray(split.label), np.asarray(split.mask)
    assert set(label[mask]) == set(range(len(PARTS)))
    assert not label[~mask].any()
    apart = {0: [], 1: []}
    for xyz, own, valid in zip(np.asarray(split.xyz), label, mask, strict=True):
        gap = KDTree(xyz[valid]).query(xyz[valid], k=4)[0][:, 3]
        for part, found in apart.items():
            found.extend(gap[own[valid] == part])
    assert np.median(apart[1]) > 2 * np.median(apart[0])


def test_walls_and_trays_are_flat_and_cables_are_not(split):
    flatness = {0: [], 4: []}
    for xyz, own, valid in zip(np.asarray(split.xyz), np.asarray(split.label), np.asarray(split.mask), strict=True):
        tree = KDTree(xyz[valid])
        for part, found in flatness.items():
            mine = xyz[valid & (own == part)]
            if len(mine) > 100:
                near = xyz[valid][tree.query(mine, k=24)[1]]
                spread = np.linalg.svd(near - near.mean(axis=1, keepdims=True), compute_uv=False)
                found.append(np.median(spread[:, 2] / spread[:, 1]))
    assert np.median(flatness[4]) < np.median(flatness[0])


@pytest.mark.usefixtures("optimized")
def test_the_same_configuration_gives_the_same_bytes_and_splits_differ(split):
    again = make_part_split(CONFIG, "train", 8)
    np.testing.assert_array_equal(np.asarray(again.xyz), np.asarray(split.xyz)[:8])
    other = make_part_split(CONFIG, "test", 8)
    assert not np.array_equal(np.asarray(other.xyz), np.asarray(again.xyz))


@pytest.fixture(scope="module")
def wide():
    with compiled_for_speed():
        return make_part_split(PartsConfig(n_points=512, mix="wide", seed=3), "train", 48)


def test_the_wide_mix_holds_all_parts_holes_and_scans_without_a_cable(wide):
    xyz, label, mask = (np.asarray(each) for each in (wide.xyz, wide.label, wide.mask))
    assert np.isfinite(xyz).all()
    assert mask.sum(axis=1).min() >= 20
    assert set(label[mask]) == set(range(len(PARTS)))
    cable = (mask & (label == 0)).sum(axis=1)
    assert 1 <= (cable == 0).sum() <= 24  # a few scans have lost their cable, most have not
    assert not np.array_equal(xyz[:16], np.asarray(make_part_split(CONFIG, "train", 16).xyz))


def test_the_wide_mix_has_five_scanners_of_other_noise_and_sizes_of_10_to_60_mm():
    scenes = [draw_scene(np.random.default_rng((0, i)), wide=True) for i in range(60)]
    sizes = np.array([2 * float(scene.scene.cable.radius_mm) for scene in scenes])
    assert 10 <= sizes.min() < 13 < 50 < sizes.max() <= 60
    standoffs = {float(scene.numbers["standoff_mm"]) for scene in scenes}
    assert standoffs == {float(PRESETS[name].standoff_mm) for name in WIDE_SCANNERS}
    assert len({float(scene.numbers["range_mm"]) for scene in scenes}) == 60
    assert len({jax.tree.structure(scene) for scene in scenes}) == 1  # one compiled program for all
    assert any(scene.gone for scene in scenes)
    assert any(scene.hole_mm > 0 for scene in scenes)


def test_what_is_asked_for_is_checked():
    for options, text in (
        ({"n_points": 8}, "n_points: expected at least 64"),
        ({"ball_mm": 0.0}, "ball_mm: expected"),
        ({"mix": "x"}, "mix: expected one of cables, wide, got 'x'"),
    ):
        with pytest.raises(ValueError, match=text):
            PartsConfig(**options)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="split: expected one of train, validation, test, got 'dev'"):
        make_part_split(CONFIG, "dev", 4)
    with pytest.raises(ValueError, match="clouds: expected at least 1, got 0"):
        make_part_split(CONFIG, "train", 0)
