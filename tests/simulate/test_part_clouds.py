"""Clouds whose points are labelled by part."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from cablejax.simulate import PARTS, Part, PartsConfig, make_part_split
from cablejax.simulate.part_clouds import GROUP
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


def test_what_is_asked_for_is_checked():
    for options, text in (({"n_points": 8}, "n_points: expected at least 64"), ({"ball_mm": 0.0}, "ball_mm: expected")):
        with pytest.raises(ValueError, match=text):
            PartsConfig(**options)
    with pytest.raises(ValueError, match="split: expected one of train, validation, test, got 'dev'"):
        make_part_split(CONFIG, "dev", 4)
    with pytest.raises(ValueError, match="clouds: expected at least 1, got 0"):
        make_part_split(CONFIG, "train", 0)
