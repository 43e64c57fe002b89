"""What the beams do to a diameter, and how a known scanner tells it."""

import dataclasses
import re

import jax
import numpy as np
import pytest

from cablejax.measure import Instrument, MeasureError, MeasureSettings, measure_cable
from cablejax.measure.fit import full
from cablejax.measure.fit.axis import Place, locate, point_at, sampled
from cablejax.measure.fit.beam_noise import _scanned, clear_of_the_rim
from cablejax.simulate import PRESETS, make_scene, scan_scene

RADIUS = 10.0


def test_spot_is_the_inverse_of_locate():
    turn = np.linspace(0, 0.8, 200)
    axis = sampled(np.stack([300 * np.sin(turn), 300 * np.cos(turn), 0 * turn], axis=1), step=2.0)
    rng = np.random.default_rng(0)
    place = Place(rng.uniform(5, 230, 500), rng.uniform(-12, 12, 500), rng.uniform(-12, 12, 500))
    for told, found in zip(place, locate(axis, point_at(axis, place)), strict=True):
        np.testing.assert_allclose(told, found, atol=1e-3)


def test_a_range_is_the_mean_over_the_footprint_weighed_by_the_light():
    footprint, aside = 0.5, np.linspace(-6, 6, 13)
    across = np.linspace(-4, 4, 4001)  # a sum over a fine grid in place of the quadrature
    height = np.sqrt(RADIUS**2 - np.clip(aside[:, None] + footprint * across, -9.99, 9.99) ** 2)
    light = np.exp(-0.5 * across**2) * height
    expected = (height * light).sum(axis=1) / light.sum(axis=1)
    nothing = np.zeros_like(aside)
    got = _scanned(aside, Instrument(0.0, footprint_mm=footprint), RADIUS, nothing, nothing)
    np.testing.assert_allclose(got, expected, atol=2e-4)
    assert np.abs(got - np.sqrt(RADIUS**2 - aside**2)).max() > 5e-3


def test_noise_grows_with_incidence_and_jitter_slides_along_the_surface():
    aside, one = np.array([0.0, 6.0]), np.ones(2)
    nothing = np.zeros(2)
    plain = np.array([10.0, 8.0])
    for power, noise in ((0.0, [1.0, 1.0]), (1.0, [1.0, 1.25])):
        got = _scanned(aside, Instrument(0.1, incidence_power=power), RADIUS, one, nothing)
        np.testing.assert_allclose(plain - got, 0.1 * np.array(noise), rtol=1e-6)
    slid = _scanned(aside, Instrument(0.0, lateral_std_mm=0.1), RADIUS, nothing, one)
    np.testing.assert_allclose(slid, np.sqrt(100 - (aside + 0.1) ** 2), rtol=1e-6)


def test_echoes_mixed_at_the_rim_are_left_out_however_deep_they_lie():
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.97 * RADIUS, 0.97 * RADIUS, 100_000)
    rim = np.abs(x) > RADIUS - 1.0
    z = -np.sqrt(RADIUS**2 - x**2) + np.where(rim, rng.uniform(0, 20, len(x)), 0.0)
    place, sweep = Place(np.zeros_like(x), x, z), np.zeros(len(x), dtype=int)
    wide, narrow, huge = (Instrument(0.1, footprint_mm=f) for f in (0.5, 0.0, 50.0))
    clear = clear_of_the_rim(place, sweep, radius_mm=RADIUS, instrument=wide)
    assert not (clear & (np.abs(x) > RADIUS - 0.8)).any()  # a fifth of the rim to spare: the direction is estimated
    assert clear[np.abs(x) < RADIUS - 1.2].all()
    assert clear_of_the_rim(place, sweep, radius_mm=RADIUS, instrument=narrow)[~rim].all()
    assert clear_of_the_rim(place, sweep, radius_mm=RADIUS, instrument=huge).any()
    assert clear_of_the_rim(place, None, radius_mm=RADIUS, instrument=wide).all()


def test_a_known_scanner_takes_off_what_its_noise_has_done():
    """Noise of a twelfth of the radius, which does not grow as an unknown scanner's is taken to: 1.5 mm too small without."""
    device = dataclasses.replace(PRESETS["terrestrial"], mixed_share=0.0)
    instrument = Instrument(device.range_mm, device.incidence_power, 0.3, device.footprint_mm)
    scene = make_scene("straight", diameter_mm=34.2, length_mm=460.0)
    errors = []
    for seed in range(4):
        scan = scan_scene(scene, device=device, n_points=8000, key=jax.random.key(seed))
        xyz = np.asarray(scan.xyz_mm, np.float64)
        both = measure_cable(xyz), measure_cable(xyz, settings=MeasureSettings(instrument=instrument))
        errors.append([result.diameter_mm - 34.2 for result in both])
        assert abs(errors[-1][1]) < 3 * both[1].std_mm < 1.5 * both[0].std_mm
    unknown, known = np.mean(errors, axis=0)
    assert unknown < -0.7
    assert abs(known) < 0.4


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Instrument)])
def test_numbers_of_a_scanner_are_checked(name: str):
    with pytest.raises(ValueError, match=f"{name}: expected a number of at least 0, got -1"):
        Instrument(**{"range_std_mm": 0.1, name: -1.0})


def swept(noise_mm: float) -> np.ndarray:
    """Three sweeps of even beams over half a cable of 20 mm, in scan order."""
    rng, found = np.random.default_rng(0), []
    for toward in np.radians([40, 90, 140]):
        x, along = rng.uniform(-9.9, 9.9, 3000), np.sort(rng.uniform(0, 200, 3000))
        z = np.sqrt(100 - x**2) + noise_mm * rng.normal(size=3000)
        ahead, aside = (np.cos(toward), np.sin(toward)), (-np.sin(toward), np.cos(toward))
        found.append(np.stack([along, z * ahead[0] + x * aside[0], z * ahead[1] + x * aside[1]], axis=1))
    return np.concatenate(found)


def test_a_scatter_unlike_the_scanners_is_told_and_less_of_it_moves_less():
    xyz = swept(0.05)
    right, wrong = (
        measure_cable(xyz, settings=MeasureSettings(instrument=Instrument(std, 0.0))) for std in (0.05, 0.5)
    )
    assert not any("scanner's numbers" in text for text in right.warnings)
    assert any(re.search(r"scatter 0\.(0[89]\d?|1|10\d?) times as much", text) for text in wrong.warnings)
    assert wrong.diameter_mm == pytest.approx(right.diameter_mm, abs=0.003)
    assert abs(right.diameter_mm - 20) < 3 * right.std_mm


def test_the_budget_tells_how_the_beams_were_reckoned_with():
    xyz = swept(0.05)
    lines = [
        {line.source: line.how for line in measure_cable(xyz, settings=settings).budget}["bias from range noise"]
        for settings in (MeasureSettings(), MeasureSettings(instrument=Instrument(0.05, 0.0)))
    ]
    assert "that were taken off" in lines[0]
    assert "scanning the fitted cable" in lines[1]


def test_without_directions_a_known_scanner_is_as_an_unknown_one():
    xyz = np.random.default_rng(1).permutation(swept(0.05))
    plain, known = measure_cable(xyz), measure_cable(xyz, settings=MeasureSettings(instrument=Instrument(0.05)))
    assert known.diameter_mm == plain.diameter_mm
    assert known.std_mm == plain.std_mm
    assert any("scanner's numbers were not used" in text for text in known.warnings)
    assert not any("scanner's numbers" in text for text in plain.warnings)


def test_numbers_with_which_the_cable_is_not_seen_again_are_said_to_be_doubtful(monkeypatch):
    def refuse(*_):
        raise MeasureError("Too few points on the cable: 3 where at least 30 are needed.")

    monkeypatch.setattr(full, "known_beam_bias", refuse)
    with pytest.raises(MeasureError, match=r"does not show it \(Too few points .* needed\)\. Are the numbers right\?"):
        measure_cable(swept(0.05), settings=MeasureSettings(instrument=Instrument(0.05)))
