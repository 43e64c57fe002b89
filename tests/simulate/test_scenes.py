"""Scenes: every name builds, clutter has exact distances and its labels, and stations know their poses."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import (
    PRESETS,
    SCENES,
    Part,
    bare,
    catalogue,
    make_scene,
    make_tube,
    neighbours,
    scan_scene,
    simulate_scan,
    station_points,
    tray,
    trefoil,
)  # fmt: skip
from cablejax.simulate.clutter import Plane, box

distances = jax.jit(lambda solid, xyz: jax.vmap(solid.signed_distance)(xyz))


@pytest.mark.parametrize(
    "name", [*SCENES, "s-bend+corrugated+tray", "bend+joint", "s-bend+termination", "bend+clamp+wall"]
)
def test_every_scene_builds_around_a_cable_that_its_outline_bounds(name):
    scene = make_scene(name, diameter_mm=30.0, length_mm=300.0)
    arc, angle = jnp.linspace(0, 300, 50), jnp.linspace(-3, 3, 50)
    points = jax.jit(lambda cable, s, a: jax.vmap(cable.point)(s, a))(scene.cable, arc, angle)
    middle = jax.vmap(lambda s: scene.cable.centreline.at(s)[0])(arc)
    radius = jnp.hypot(jnp.linalg.norm(points[:, :2] - middle, axis=1), points[:, 2])
    assert float(radius.max()) <= float(scene.cable.outline_mm) + 1e-3


def test_box_distance_against_the_nearest_of_many_surface_points():
    solid = box((1.0, -2.0, 3.0), (4.0, 2.0, 1.0), Part.TRAY)
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-8, 8, (400, 3)) + np.array([1.0, -2.0, 3.0])
    # exact: the distance to each of the six rectangles in float64, signed by the inside test
    local, half = xyz - np.array([1.0, -2.0, 3.0]), np.array([4.0, 2.0, 1.0])
    nearest = np.full(400, np.inf)
    for axis in range(3):
        for side in (-1, 1):
            foot = np.clip(local, -half, half)
            foot[:, axis] = side * half[axis]
            nearest = np.minimum(nearest, np.linalg.norm(local - foot, axis=1))
    expected = np.where((np.abs(local) < half).all(axis=1), -nearest, nearest)
    assert np.allclose(distances(solid, jnp.asarray(xyz, jnp.float32)), expected, atol=5e-6)
    assert (expected < 0).sum() > 3


@pytest.mark.parametrize("line", ["straight", "s-bend"])
def test_trefoil_cables_touch_all_along(line):
    scene = make_scene(f"{line}+trefoil", diameter_mm=30.0, length_mm=300.0)
    upper = scene.cable
    one, two = scene.solids
    axis = jax.jit(lambda tube, arc: jax.vmap(lambda s: jnp.append(tube.centreline.at(s)[0], 0.0))(arc))
    arc = jnp.linspace(10.0, 290.0, 40)
    for solid in (one, two):
        on_axis = axis(solid.tube, arc) + solid.shift_mm[None, :]
        # from axis to sheath of a touching cable: its radius; coordinates of 150 mm are known to 1.5e-5 mm
        assert np.allclose(distances(upper, on_axis), 15.0, atol=1e-4)
    assert np.allclose(distances(two, axis(one.tube, arc) + one.shift_mm[None, :]), 15.0, atol=1e-4)


def test_neighbours_of_what_has_no_parallels_are_refused():
    with pytest.raises(ValueError, match="cable: expected a straight or bent one"):
        trefoil(make_tube("catenary", diameter_mm=30.0, length_mm=100.0))
    tight = make_tube("bend", diameter_mm=30.0, length_mm=100.0, bend_radius_mm=60.0)
    with pytest.raises(ValueError, match=r"offsets_mm: expected less than the bend radius, got 50\.0 across"):
        neighbours(tight, [(50.0, 0.0)])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("bend+knot", "got 'knot'"),
        ("bend+straight", "at most one line of straight, .*, got bend and straight"),
        ("oval+joint", "at most one sheath or accessory of .*, got oval and joint"),
        ("wall+tray", "at most one surrounding of .*, got wall and tray"),
        ("catenary+joint", "hangs in a catenary"),
    ],
)
def test_names_that_do_not_go_together(name, words):
    with pytest.raises(ValueError, match=words):
        make_scene(name, diameter_mm=30.0, length_mm=400.0)


def test_a_tray_is_as_wide_as_a_bent_cable_needs():
    scene = make_scene("bend+tray", diameter_mm=30.0, length_mm=900.0)
    arc = jnp.linspace(0.0, 900.0, 60)
    middle = jax.vmap(lambda s: jnp.append(scene.cable.centreline.at(s)[0], 0.0))(arc)
    assert float(jnp.abs(middle[:, 1]).max()) > 75  # wider than the usual tray
    for side in scene.solids[1:]:
        assert float(distances(side, middle).min()) > 15.0


def test_a_wall_in_any_direction():
    toward = np.array([0.0, 0.6, -0.8])
    solid = Plane(jnp.asarray(toward, jnp.float32), jnp.float32(-30.0), jnp.int32(Part.WALL))
    xyz = np.random.default_rng(0).uniform(-90, 90, (50, 3))
    assert np.allclose(distances(solid, jnp.asarray(xyz, jnp.float32)), xyz @ toward + 30.0, atol=2e-5)
    assert np.allclose(solid.near(jnp.zeros(3))[1], toward)


def test_parts_are_labelled_by_what_was_met():
    scan = simulate_scan(catalogue()[5], n_points=3000, preset="ideal", shape="tray", key=jax.random.key(0))
    part, xyz = np.asarray(scan.part), np.asarray(scan.xyz_mm)
    assert set(np.unique(part)) == {Part.CABLE, Part.AIR, Part.TRAY}
    assert np.array_equal(part == Part.AIR, scan.is_outlier)
    on_cable = part == Part.CABLE
    assert np.abs(np.asarray(scan.signed_distance_mm)[on_cable]).max() < 1e-4
    solids = tray(make_tube("straight", diameter_mm=catalogue()[5].diameter_mm, length_mm=400.0)).solids
    gap = np.min([np.abs(distances(solid, jnp.asarray(xyz[part == Part.TRAY]))) for solid in solids], axis=0)
    assert gap.max() < 1e-3
    # the tray hides the cable from below: nothing of it is seen through the floor
    assert (scan.station[on_cable] == 1).mean() > 0.5


def test_stations_look_at_the_cable_from_their_standoff():
    scan = simulate_scan(
        catalogue()[8], n_points=4000, preset="ideal", shape="bend", key=jax.random.key(0)
    )  # a shape compiled for other tests too
    poses = np.asarray(scan.T_cable_station, np.float64)
    assert poses.shape == (3, 4, 4)
    rotation, origin = poses[:, :3, :3], poses[:, :3, 3]
    assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3), atol=1e-6)
    assert np.allclose(np.linalg.det(rotation), 1, atol=1e-6)
    # the middle of the cable is the frame's origin: straight ahead, at the standoff of 300 mm
    assert np.allclose(-origin / 300.0, rotation[:, :, 2], atol=1e-5)


def test_what_a_station_measured_lies_on_the_cable_by_its_true_pose():
    tube = make_tube("bend", diameter_mm=30.0, length_mm=300.0)
    device = dataclasses.replace(PRESETS["ideal"], registration_mm=0.5, resweep_share=0.3)
    scan = scan_scene(bare(tube), device=device, n_points=4000, key=jax.random.key(1))
    assert float(jnp.abs(scan.signed_distance_mm[~scan.is_outlier]).max()) > 0.2
    seen = 0
    for station in range(3):
        pose = scan.T_cable_station[station]
        points = station_points(scan, station) @ pose[:3, :3].T + pose[None, :3, 3]
        # coordinates of up to 350 mm in the station's frame are known to 3e-5 mm, and turned twice
        assert float(jnp.abs(distances(tube, points)).max()) < 3e-4
        assert float(station_points(scan, station)[:, 2].min()) > 250  # in front of the station
        seen += len(points)
    assert seen == int((~scan.is_outlier).sum())
    assert bool((scan.sweep == 1).any())
    with pytest.raises(ValueError, match="station: expected 0 to 2, got 3"):
        station_points(scan, 3)


def test_refuses():
    with pytest.raises(ValueError, match=r"shape: expected one of straight, .*, got 'knot'"):
        make_scene("knot", diameter_mm=30.0, length_mm=300.0)
    with pytest.raises(ValueError, match="bend_radius_mm: expected none for 'tray'"):
        make_scene("tray", diameter_mm=30.0, length_mm=300.0, bend_radius_mm=500.0)
