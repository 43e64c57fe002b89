"""Scenes: every name builds, clutter has exact distances and its labels, and stations know their poses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import SCENES, Part, catalogue, make_scene, make_tube, simulate_scan, tray, trefoil
from cablejax.simulate.clutter import box

distances = jax.jit(lambda solid, xyz: jax.vmap(solid.signed_distance)(xyz))


@pytest.mark.parametrize("name", SCENES)
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


def test_trefoil_cables_touch():
    cable = make_tube("straight", diameter_mm=30.0, length_mm=100.0)
    shifts = [np.zeros(3), *(np.asarray(solid.shift_mm) for solid in trefoil(cable).solids)]
    gaps = [np.linalg.norm(shifts[i] - shifts[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    assert gaps == pytest.approx([30.0, 30.0, 30.0], abs=1e-4)
    with pytest.raises(ValueError, match="cable: expected a straight one for a trefoil"):
        trefoil(make_tube("bend", diameter_mm=30.0, length_mm=100.0))


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


def test_refuses():
    with pytest.raises(ValueError, match=r"shape: expected one of straight, .*, got 'knot'"):
        make_scene("knot", diameter_mm=30.0, length_mm=300.0)
    with pytest.raises(ValueError, match="bend_radius_mm: expected none for 'tray'"):
        make_scene("tray", diameter_mm=30.0, length_mm=300.0, bend_radius_mm=500.0)
