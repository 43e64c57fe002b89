"""Sweeps told from the order of the rows, the edges of what they saw, and the bias of noise along their beams."""

import numpy as np
import pytest

from cablejax.measure import measure_cable
from cablejax.measure.fit.axis import Place
from cablejax.measure.fit.beam_noise import incidence
from cablejax.measure.fit.sweep_labels import at_the_edge, sweeps_of

SHIFT = np.array([[0.0, 0.0, 0.0], [0.0, 0.08, -0.1], [0.0, -0.05, 0.09]])


def scanned(*, noise=0.1, radius=15.0, shift=SHIFT, lines=120, columns=40, arc_deg=180.0) -> np.ndarray:
    """A straight cable in scan order: one sweep after another from -60, 0 and 60 degrees, beams evenly across the view."""
    rng = np.random.default_rng(0)
    clouds = []
    for middle, moved in zip((-60.0, 0.0, 60.0), shift, strict=True):
        s = np.repeat(np.linspace(0, 400, lines), columns)
        across = np.tile(np.linspace(-0.97, 0.97, columns), lines) + rng.uniform(-0.02, 0.02, lines * columns)
        turned = np.arcsin(np.clip(across, -0.99, 0.99))
        angle = turned + np.radians(middle)
        error = noise * rng.normal(size=len(s)) / np.cos(turned)  # along the beam
        beam = -np.array([np.cos(np.radians(middle)), np.sin(np.radians(middle))])
        yz = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + error[:, None] * beam
        keep = np.abs(np.degrees(angle)) < arc_deg / 2
        clouds.append((np.column_stack([s, yz]) + moved)[keep])
    return np.concatenate(clouds)


@pytest.mark.parametrize("back", [False, True])
def test_runs_along_the_cable_are_sweeps(back):
    rng = np.random.default_rng(1)
    runs = [np.linspace(0, 100, 1500), np.linspace(0, 100, 1500), np.linspace(30, 60, 600)]
    along = np.concatenate([run[::-1] if back and i == 1 else run for i, run in enumerate(runs)])
    found = sweeps_of(along + 0.3 * rng.normal(size=len(along)))
    assert found is not None
    starts = np.flatnonzero(np.diff(found)) + 1
    assert len(starts) == 2
    np.testing.assert_allclose(starts, [1500, 3000], atol=50)


def test_rows_in_no_order_have_no_sweeps():
    along = np.random.default_rng(1).uniform(0, 100, 5000)
    assert sweeps_of(along) is None
    assert sweeps_of(np.sort(along)) is None  # a single run says nothing about how many scans it was put together from
    assert sweeps_of(along[:50]) is None


def test_incidence_is_told_from_the_density():
    xyz = scanned(noise=0.0, shift=np.zeros((3, 3)))
    angle = np.arctan2(xyz[:, 2], xyz[:, 1])
    sweep = sweeps_of(xyz[:, 0])
    found = incidence(angle, sweep)
    assert found is not None
    for name, middle in enumerate((-60.0, 0.0, 60.0)):
        expected = angle[sweep == name] - np.radians(middle)
        np.testing.assert_allclose(found[sweep == name], expected, atol=np.radians(5))


def test_edges_are_left_out_and_holes_are_not():
    angle = np.radians(np.repeat(np.arange(-45.0, 45.0, 0.05), 2))
    angle = angle[(np.degrees(angle) < 10) | (np.degrees(angle) > 20)]
    place = Place(np.zeros(len(angle)), 15 * np.cos(angle), 15 * np.sin(angle))
    left = np.degrees(angle[~at_the_edge(place, None, noise_mm=0.1, radius_mm=15.0)])
    assert -43 < left.min() < -41
    assert 41 < left.max() < 43
    assert (np.abs(left - 9) < 1).any()


def test_shifts_of_sweeps_do_not_reach_the_diameter():
    xyz = scanned()
    shuffled = xyz[np.random.default_rng(0).permutation(len(xyz))]
    ordered, blind = measure_cable(xyz), measure_cable(shuffled)
    assert abs(ordered.diameter_mm - 30) < 3 * ordered.std_mm
    assert ordered.std_mm < 0.02 < blind.std_mm
    assert abs(blind.diameter_mm - 30) < 3 * blind.std_mm


def test_a_short_noisy_arc_is_not_found_too_small():
    # Uncorrected, 0.35 mm along the beams of a 60 degree arc brings the diameter down by 0.7 mm.
    errors = [
        measure_cable(scanned(noise=0.35, arc_deg=60.0, shift=SHIFT * k, lines=300)).diameter_mm - 30 for k in (0, 1)
    ]
    assert np.abs(errors).max() < 0.5


def test_sweeps_that_are_shifted_warn_of_the_ovality():
    warnings = measure_cable(scanned(arc_deg=360.0)).warnings
    assert any("an oval section passes for shifts in part" in warning for warning in warnings)
