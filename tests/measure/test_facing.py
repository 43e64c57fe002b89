"""A heap of small things near a large cylinder is none: its points face elsewhere."""

import numpy as np
import pytest

from cablejax.measure.fit.axis import sampled
from cablejax.measure.fit.least_squares import fit_cable
from cablejax.measure.shape.facing import OUTWARD, faces_elsewhere

RADIUS, LENGTH = 40.0, 120.0
LINE = sampled(np.array([[0.0, 0, 0], [LENGTH, 0, 0]]), step=4.0)


def cylinder(rng: np.random.Generator, *, arc: float, noise: float, n: int = 12_000) -> np.ndarray:
    along, angle = rng.uniform(0, LENGTH, n), np.radians(rng.uniform(-arc / 2, arc / 2, n))
    rough = RADIUS + noise * rng.normal(size=n)
    return np.stack([along, rough * np.cos(angle), rough * np.sin(angle)], axis=1)


def heap(rng: np.random.Generator, *, pins: int = 80, each: int = 600) -> np.ndarray:
    """Pins 6 mm thick and 30 mm long that lie anyhow with their middles on the upper side of a cylinder, seen from above."""
    angle, along = np.radians(rng.uniform(-45, 45, pins)), rng.uniform(5, LENGTH - 5, pins)
    middle = np.stack([along, RADIUS * np.cos(angle), RADIUS * np.sin(angle)], axis=1)
    axis = rng.normal(size=(pins, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    side = np.cross(axis, np.roll(axis, 1, axis=1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turn, place = rng.uniform(0, 2 * np.pi, (pins, each, 1)), rng.uniform(-15, 15, (pins, each, 1))
    out = np.cos(turn) * side[:, None] + np.sin(turn) * np.cross(axis, side)[:, None]
    points = middle[:, None] + place * axis[:, None] + 3 * out
    return points[out[..., 1] > 0]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("arc", "noise"), [(70.0, 0.2), (180.0, 2.0), (360.0, 4.0)])
def test_a_cylinder_faces_out(seed, arc, noise):
    xyz = cylinder(np.random.default_rng(seed), arc=arc, noise=noise)
    assert faces_elsewhere(xyz, fit_cable(xyz, LINE, RADIUS)) is None


@pytest.mark.parametrize("seed", range(5))
def test_a_heap_of_pins_does_not(seed):
    xyz = heap(np.random.default_rng(seed))
    fit = fit_cable(xyz, LINE, RADIUS)
    found = faces_elsewhere(xyz, fit)
    assert found is not None
    assert found < OUTWARD - 0.04


def test_where_normals_tell_nothing_nothing_is_said():
    rng = np.random.default_rng(0)
    rough = cylinder(rng, arc=360.0, noise=0.2 * RADIUS)
    assert faces_elsewhere(rough, fit_cable(rough, LINE, RADIUS)) is None
    few = heap(rng, pins=12, each=6)  # neighbours reach farther than half a radius
    assert faces_elsewhere(few, fit_cable(few, LINE, RADIUS)) is None
