"""Two scans of which nothing is known: the right motion, or a refusal, or what speaks against it."""

import numpy as np
import pytest

from cablejax.geometry.voxels import voxel_means
from cablejax.registration import icp, register, register_auto
from cablejax.registration.automatic import scales_of
from tests.reference.circles import bent_cable
from tests.registration.test_coarse import apart, pose, room, seen_from


@pytest.mark.parametrize("turn", [[0.0, 0.0, 3.0], [0.0, 0.0, 150.0]], ids=["near", "turned"])
def test_any_pose_is_found_without_a_number_given(turn):
    truth = pose(turn, [0.05, -0.04, 0.02] if turn[2] < 10 else [3.0, -2.0, 0.5])
    found = register_auto(seen_from(truth, room(1)), room(2))
    metres, radians = apart(found.result.T_target_source, truth)
    assert metres < 0.01  # noise of 2 mm on 12,000 points: some voxels' means are off by a few millimetres
    assert radians < 0.01
    assert found.doubts == ()
    assert found.overlap > 0.9
    assert found.rival is None or found.rival < 0.7


def test_scales_leave_some_thousand_voxels_and_halve():
    xyz = room(3)
    sides = scales_of(xyz)
    assert 1_500 <= len(voxel_means(xyz, sides[0])) < 4_500
    np.testing.assert_allclose(np.divide(sides[:-1], sides[1:]), 2.0)


def test_scans_with_nothing_in_common_are_doubted_or_refused():
    noise = np.random.default_rng(0).uniform(size=(3000, 3)) * [
        2.0,
        1.5,
        1.0,
    ]  # fills the room: some of it lies on walls
    doubts = " ".join(register_auto(noise, room(2)).doubts)
    assert "of the source lie on the target" in doubts
    assert "root mean square" in doubts
    with pytest.raises(ValueError, match="of the source onto the target, where at least 10 %"):
        register_auto(noise * 1000, room(2))  # millimetres, onto metres


def test_what_a_cable_does_not_show_is_a_doubt():
    found = register_auto(np.add(bent_cable(n=4000, seed=1), [0.0, 0.5, -0.3]), bent_cable(n=4000))
    assert any("of 6 directions of motion are not seen" in text for text in found.doubts)


@pytest.mark.parametrize("points", range(6))
@pytest.mark.parametrize("side", ["source", "target"])
def test_a_handful_of_points_is_refused_by_all(points, side):
    few, many = np.zeros((points, 3)), room(0, n=300)
    pair = (few, many) if side == "source" else (many, few)
    for register_them in (icp, register_auto, lambda a, b: register(a, b, voxels=[0.1])):
        with pytest.raises(ValueError, match=f"{side}: expected at least 6 points, got {points}"):
            register_them(*pair)
