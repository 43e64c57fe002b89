"""What the beams do to a diameter, against points made beam by beam."""

import dataclasses
import re

import numpy as np
import pytest

from cablejax.measure import Instrument, MeasureSettings, measure_cable
from cablejax.measure.axis import Axis, Place
from cablejax.measure.beams import beam_bias
from cablejax.measure.fit import CableFit

RADIUS = 10.0
WIDEST = np.radians(60)


def beams(instrument: Instrument, n: int = 2_000_000) -> tuple[np.ndarray, np.ndarray]:
    """Points `[n, 2]` where even beams along z meet a circle; the scanner is far below. The footprint is averaged over."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.97 * RADIUS, 0.97 * RADIUS, n)
    met = x + instrument.lateral_std_mm * rng.normal(size=n)
    keep = np.abs(met) < 0.98 * RADIUS
    x, met = x[keep], met[keep]
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    width = met[:, None] + instrument.footprint_mm * nodes[None, :]
    inside = np.maximum(RADIUS**2 - width**2, 0.0)
    z = -(np.sqrt(inside) @ weights) / weights.sum()
    cosine = np.sqrt(1 - (met / RADIUS) ** 2)
    return x, z + instrument.range_std_mm * cosine**-instrument.incidence_power * rng.normal(size=len(x))


def bare_fit(u: np.ndarray, v: np.ndarray, noise_mm: float) -> tuple[CableFit, np.ndarray]:
    """A fit as of a known circle in which the points within `WIDEST` of the scanner's direction count alike."""
    distance = np.hypot(u, v)
    counted = np.abs(np.arctan2(u, -v)) < WIDEST
    nothing = np.zeros_like(u)
    fit = CableFit(
        Axis(np.zeros((2, 3)), np.arange(2.0), np.eye(3)[:2], np.eye(3)[:2]), RADIUS, noise_mm, 0.0, 0.0,
        Place(nothing, u, v), distance - RADIUS, counted.astype(float), counted / counted.sum(),
    )  # fmt: skip
    return fit, counted


@pytest.mark.parametrize(
    "instrument",
    [
        Instrument(0.2),
        Instrument(0.2, incidence_power=0.5),
        Instrument(0.2, incidence_power=0.0),
        Instrument(0.1, lateral_std_mm=0.2),
        Instrument(0.02, footprint_mm=0.4),
    ],
    ids=["triangulation", "time of flight", "even noise", "jitter", "wide beam"],
)
def test_the_bias_is_that_of_points_made_beam_by_beam(instrument: Instrument):
    u, v = beams(instrument)
    fit, counted = bare_fit(u, v, 0.2)
    found = 2 * float(np.mean(fit.residual_mm[counted]))
    told = beam_bias(fit._replace(noise_mm=10.0), np.zeros(len(u), dtype=int), instrument)
    assert told.total_mm == pytest.approx(found, abs=0.0012)
    assert abs(found) > 0.0025


def test_an_unknown_scanner_is_taken_for_one_whose_noise_grows_with_incidence():
    u, v = beams(Instrument(0.2))
    fit, _ = bare_fit(u, v, 0.2)
    sweep = np.zeros(len(u), dtype=int)
    unknown, known = beam_bias(fit, sweep), beam_bias(fit, sweep, Instrument(0.2))
    assert unknown.noise_mm == pytest.approx(known.noise_mm, rel=1e-6)
    assert known.noise_doubt_mm < unknown.noise_doubt_mm
    assert (unknown.width_mm, unknown.width_doubt_mm) == (0.0, 0.0)


def test_less_scatter_than_the_scanner_leaves_moves_less():
    u, v = beams(Instrument(0.2))
    sweep = np.zeros(len(u), dtype=int)
    as_told, filtered = (beam_bias(bare_fit(u, v, noise)[0], sweep, Instrument(0.2)) for noise in (0.2, 0.1))
    assert filtered.noise_mm == pytest.approx(as_told.noise_mm / 4, rel=0.02)
    assert filtered.excess == pytest.approx(0.5, rel=0.02)


def test_a_wide_beam_leaves_out_more_of_the_rim():
    assert Instrument(0.1).grazing(10.0) == 0.0
    assert Instrument(0.1, footprint_mm=0.5).grazing(10.0) == pytest.approx(np.sqrt(1 - 0.9**2))
    assert Instrument(0.1, footprint_mm=9.0).grazing(10.0) == 1.0


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Instrument)])
def test_numbers_of_a_scanner_are_checked(name: str):
    with pytest.raises(ValueError, match=f"{name}: expected a number of at least 0, got -1"):
        Instrument(**{"range_std_mm": 0.1, name: -1.0})


def test_a_budget_names_the_width_and_a_warning_the_wrong_scanner():
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(0, np.pi, 4000), rng.uniform(0, 200, 4000)
    xyz = np.stack([along, 10 * np.cos(angle), 10 * np.sin(angle)], axis=1) + 0.05 * rng.normal(size=(4000, 3))
    right = measure_cable(xyz, settings=MeasureSettings(instrument=Instrument(0.05, footprint_mm=0.3)))
    wrong = measure_cable(xyz, settings=MeasureSettings(instrument=Instrument(0.5)))
    plain = measure_cable(xyz)
    assert "width of the beams" in {line.source for line in right.budget}
    assert "width of the beams" not in {line.source for line in plain.budget}
    assert right.diameter_mm > plain.diameter_mm + 0.005
    assert not any("scanner's numbers" in text for text in right.warnings + plain.warnings)
    assert any(re.search(r"scatter 0\.(1|09\d|10\d) times as much", text) for text in wrong.warnings)
