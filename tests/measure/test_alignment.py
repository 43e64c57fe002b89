"""Stations that do not fit together: seen in the residuals, put into the interval, fitted where stations are known."""

import numpy as np

from cablejax.measure import measure_cable
from cablejax.measure.fit.sweep_labels import blocks
from cablejax.measure.uncertainty.alignment import shared_errors
from tests.reference.circles import bent_cable

SHIFT = np.array([[0.0, 0.0, 0.0], [0.0, 0.08, -0.1], [0.0, -0.05, 0.09]])


def three_stations() -> tuple[np.ndarray, np.ndarray]:
    """A half arc seen from -60, 0 and 60 degrees, 80 degrees to either side, each station with a shift of its own."""
    xyz = bent_cable(noise=0.05, n=9000)
    angle = np.degrees(np.arctan2(xyz[:, 1], xyz[:, 2]))
    rng = np.random.default_rng(2)
    far = np.abs(angle[:, None] - np.array([-60.0, 0.0, 60.0])[None, :])
    station = np.argmax(np.where(far < 80, rng.uniform(size=far.shape), -1), axis=1)
    return xyz + SHIFT[station], station


def test_known_stations_are_fitted_and_the_diameter_is_right():
    xyz, station = three_stations()
    blind, known = measure_cable(xyz), measure_cable(xyz, station=station)
    assert abs(known.diameter_mm - 30) < 0.015  # noise alone: .003 mm, times 3 for centres free by station
    assert abs(blind.diameter_mm - 30) > 2 * abs(known.diameter_mm - 30)
    assert known.std_mm < 0.5 * blind.std_mm
    assert abs(blind.diameter_mm - 30) < 3 * blind.std_mm


def test_without_shared_errors_the_profile_adds_little():
    rng = np.random.default_rng(4)
    angle = rng.uniform(0, 2 * np.pi, 20_000)
    found = shared_errors(angle, 0.1 * rng.normal(size=20_000), np.ones(20_000))
    assert found is not None
    # Noise alone leaves .1 / sqrt(20,000) in the mean of a whole circle: shifts much larger than that would show.
    assert found.std_mm < 4 * 0.1 / np.sqrt(20_000)
    assert abs(found.change_mm) < 2 * 0.1 / np.sqrt(20_000)


def test_a_shift_of_the_whole_scan_is_no_error_of_the_radius():
    rng = np.random.default_rng(4)
    angle = rng.uniform(0, np.pi, 20_000)
    residual = 0.3 * np.cos(angle - 1) + 0.1 * rng.normal(size=20_000)
    found = shared_errors(angle, residual, np.ones(20_000))
    assert found is not None
    assert found.std_mm < 0.01


def test_what_shifted_stations_did_to_a_whole_circle_is_taken_off():
    """Four stations pushed in and out by turns, each seen by the cosine of the incidence: a circle looks too small."""
    rng = np.random.default_rng(5)
    wrong, right = [], []
    for _ in range(20):
        angle = rng.uniform(0, 2 * np.pi, 40_000)
        place = rng.uniform(0, 2 * np.pi) + np.arange(4) * np.pi / 2
        seen = np.clip(np.cos(angle[:, None] - place), 0, None)
        pick = (seen.cumsum(axis=1) / seen.sum(axis=1, keepdims=True) > rng.uniform(size=(40_000, 1))).argmax(axis=1)
        shift = 0.05 * rng.normal(size=(4, 2))[pick]
        residual = shift[:, 0] * np.cos(angle) + shift[:, 1] * np.sin(angle) + 0.1 * rng.normal(size=40_000)
        circle = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
        fitted, *_ = np.linalg.lstsq(circle, residual, rcond=None)
        found = shared_errors(angle, residual - circle @ fitted, np.ones(40_000))
        assert found is not None
        wrong.append(fitted[0])
        right.append(fitted[0] + found.change_mm)
    assert np.std(right) < 0.7 * np.std(wrong)


def test_what_is_not_round_is_doubted_and_not_taken_off():
    """A handle on a quarter of the circumference, ten times as high as the noise."""
    rng = np.random.default_rng(6)
    angle = rng.uniform(0, 2 * np.pi, 20_000)
    residual = 0.1 * rng.normal(size=20_000) + np.where(np.abs(angle - 2) < np.pi / 4, 1.0, 0.0)
    circle = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    fitted, *_ = np.linalg.lstsq(circle, residual, rcond=None)
    found = shared_errors(angle, residual - circle @ fitted, np.ones(20_000))
    assert found is not None
    assert found.change_mm == 0
    assert found.std_mm > 0.5 * abs(fitted[0])


def test_too_few_directions_give_none():
    assert shared_errors(np.full(100, 0.1), np.zeros(100), np.ones(100)) is None


def test_blocks_number_every_station_and_stretch():
    station = np.array([0, 0, 1, 1, 0])
    along = np.array([0.0, 10.0, 0.0, 10.0, 4.0])
    assert blocks(station, along, pieces=2).tolist() == [0, 1, 2, 3, 0]
