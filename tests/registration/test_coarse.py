"""A start for unknown poses, and several stations in one frame, on scenes whose poses are known."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cablejax.registration import coarse_start, register, register_stations
from cablejax.registration.graph import Edge, solve_graph, spanning
from cablejax.simulate import catalogue, simulate_scan, station_points

VOXELS = (0.08, 0.04)


def room(seed: int, n: int = 12_000) -> np.ndarray:
    """Floor, two walls and two boxes of different sizes: no symmetry, noise of 2 mm on a room of 2 by 1.5 by 1 m."""
    rng = np.random.default_rng(seed)
    boxes = [([0, 0, 0], [2, 1.5, 0]), ([0, 0, 0], [0, 1.5, 1]), ([0, 0, 0], [2, 0, 1])]
    for low, high in (([0.4, 0.3, 0], [0.8, 0.9, 0.3]), ([1.3, 0.8, 0], [1.6, 1.1, 0.7])):
        for axis in range(3):
            face = list(high)
            face_low = list(low)
            face_low[axis] = face[axis]
            boxes.append((face_low, face))
    area = np.array([np.prod(np.sort(np.subtract(high, low))[1:]) for low, high in boxes])
    pick = rng.choice(len(boxes), size=n, p=area / area.sum())
    low, high = (np.array([box[i] for box in boxes], dtype=float)[pick] for i in (0, 1))
    return rng.uniform(low, np.maximum(high, low)) + 0.002 * rng.normal(size=(n, 3))


def pose(rotation_deg: list[float], shift: list[float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.radians(rotation_deg)).as_matrix()
    T[:3, 3] = shift
    return T


def seen_from(T_world_station: np.ndarray, world: np.ndarray) -> np.ndarray:
    return (world - T_world_station[:3, 3]) @ T_world_station[:3, :3]


def apart(T: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Metres at the middle of the room, and radians."""
    error = np.linalg.inv(truth) @ T
    middle = np.append(seen_from(truth, np.array([[1.0, 0.75, 0.3]]))[0], 1.0)
    return float(np.linalg.norm((error @ middle - middle)[:3])), float(
        np.linalg.norm(Rotation.from_matrix(error[:3, :3]).as_rotvec())
    )


@pytest.mark.parametrize("turn", [[0.0, 0.0, 120.0], [70.0, 70.0, 70.0]], ids=["about z", "about the diagonal"])
def test_a_turn_of_120_degrees_is_found(turn):
    truth = pose(turn, [3.0, -2.0, 0.5])
    source, target = seen_from(truth, room(1)), room(2)
    begin = coarse_start(source, target, voxel=VOXELS[0])
    # A start is good enough within two voxels and the 0.2 rad from which the fine levels converge.
    metres, radians = apart(begin.T_target_source, truth)
    assert metres < 2 * VOXELS[0]
    assert radians < 0.2
    assert begin.overlap > 0.5
    found = register(source, target, voxels=VOXELS, start="features")
    metres, radians = apart(found.T_target_source, truth)
    assert metres < 2e-3  # noise of 2 mm on some 1,500 voxel means, 0.1 mm, and the bias of means over edges
    assert radians < 3e-3


def test_three_stations_come_into_the_frame_of_the_first():
    poses = np.stack([np.eye(4), pose([0, 0, 4], [0.05, -0.03, 0.02]), pose([3, -2, 0], [-0.04, 0.05, 0.0])])
    world = [room(seed) for seed in (3, 4, 5)]
    world[2] = world[2][world[2][:, 0] < 1.3]  # not all see all
    clouds = [seen_from(T, xyz) for T, xyz in zip(poses, world, strict=True)]
    found = register_stations(clouds, voxels=VOXELS)
    np.testing.assert_array_equal(found.T_world_station[0], np.eye(4))
    for T, truth in zip(found.T_world_station[1:], poses[1:], strict=True):
        metres, radians = apart(T, truth)
        assert metres < 2e-3
        assert radians < 3e-3
    assert set(found.pairs) == {(1, 0), (2, 0), (2, 1)}
    assert found.rmse < VOXELS[-1]


def test_stations_of_a_cable_come_together_across_it_and_stay_along_it():
    scan = simulate_scan(
        catalogue()[8], n_points=24_000, shape="s-bend", arc_deg=120.0, stations=3, key=jax.random.key(7)
    )
    clouds = [np.asarray(station_points(scan, i), dtype=np.float64) for i in range(3)]
    poses = np.asarray(scan.T_cable_station, dtype=np.float64)
    truth = np.linalg.inv(poses[0]) @ poses
    starts = [truth[0]]
    for T, cloud, shift in zip(truth[1:], clouds[1:], ([0.5, 1.0, -1.0], [-1.3, -0.2, -0.6]), strict=True):
        middle = cloud.mean(axis=0)
        off = pose([0.5, -0.5, 0.5], [0, 0, 0])
        off[:3, 3] = middle - off[:3, :3] @ middle + shift
        starts.append(T @ off)
    found = register_stations(clouds, voxels=(3.0, 1.5), T_world_station=np.stack(starts))
    axis = np.linalg.svd(clouds[0] - clouds[0].mean(axis=0), full_matrices=False)[2][0]
    for T, start, true, cloud in zip(found.T_world_station[1:], starts[1:], truth[1:], clouds[1:], strict=True):
        middle = np.append(cloud.mean(axis=0), 1.0)
        before, after = (((pose_ - true) @ middle)[:3] for pose_ in (start, T))
        across_before, across = (each - (each @ axis) * axis for each in (before, after))
        assert np.linalg.norm(across_before) > 0.6
        assert np.linalg.norm(across) < 0.15  # .02 and .06 mm here; noise, and the bias of voxel means
        assert abs((after - before) @ axis) < 0.2
    assert all(result.observability[0] < 0.01 <= result.observability[1] for result in found.pairs.values())


def test_what_disagrees_is_spread_by_its_certainty():
    # Three stations on a line: 0 to 1 and 1 to 2 say 1 m each, 0 to 2 says 2.3 m with a ninth of the certainty of each.
    def edge(source, target, shift, certainty):
        return Edge(source, target, pose([0, 0, 0], [shift, 0, 0]), certainty * np.eye(6), np.zeros(3))

    edges = [edge(1, 0, 1.0, 9.0), edge(2, 1, 1.0, 9.0), edge(2, 0, 2.3, 1.0)]
    poses = solve_graph(spanning(3, edges, [1.0, 1.0, 0.5]), edges)
    # Chain and shortcut in series and parallel: the chain of two counts 9 / 2, so the end is (4.5 * 2 + 2.3) / 5.5; the
    # robust weight takes some of the shortcut's share, never more than all of it.
    assert 2.0 < poses[2, 0, 3] <= (4.5 * 2 + 2.3) / 5.5 + 1e-9
    assert poses[1, 0, 3] == pytest.approx(poses[2, 0, 3] / 2, abs=1e-6)


def test_unseen_directions_stay_where_they_began():
    blind = np.diag([1.0, 0.0, 1.0, 1.0, 1.0, 1.0])  # nothing is known along y
    edges = [Edge(1, 0, pose([0, 0, 0], [1.0, 0.7, 0.0]), blind, np.zeros(3))]
    poses = solve_graph(np.stack([np.eye(4), pose([0, 0, 0], [0.8, 0.2, 0.1])]), edges)
    np.testing.assert_allclose(poses[1, :3, 3], [1.0, 0.2, 0.0], atol=1e-9)


def test_stations_that_share_nothing_are_named():
    with pytest.raises(ValueError, match=r"clouds: number 1 \(from 0\) could not be joined"):
        register_stations([room(1, 3000), room(2, 3000) + 50.0], voxels=[0.08])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"clouds": [np.zeros((9, 3))]}, "clouds: expected two or more, got 1"),
        ({"start": "luck"}, "start: expected one of given, features, got 'luck'"),
        ({"T_world_station": np.eye(4)[None]}, r"T_world_station: expected shape \[2, 4, 4\], got \[1, 4, 4\]"),
    ],
)
def test_wrong_arguments_are_named(change, message):
    arguments = {"clouds": [np.zeros((9, 3))] * 2, "voxels": [0.1]} | change
    with pytest.raises(ValueError, match=message):
        register_stations.__wrapped__(arguments.pop("clouds"), **arguments)


def test_too_few_voxels_for_a_coarse_start():
    with pytest.raises(ValueError, match="source: expected at least 30 voxels of 5 with points, got 1"):
        coarse_start(room(1, 500) + 1, room(2, 500), voxel=5.0)
