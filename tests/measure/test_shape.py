"""The section's shape: ovality along the length, and a closed curve of any form."""

import numpy as np
import pytest

from cablejax.measure import measure_cable
from cablejax.measure.shape.sections import between
from tests.reference.circles import bent_cable


@pytest.fixture(scope="module")
def oval():
    return measure_cable(bent_cable(oval=0.3, arc_deg=360.0, n=12_000))


def test_each_section_has_its_least_and_greatest_diameter(oval):
    low, high = oval.sections.minimum_mm, oval.sections.maximum_mm
    inner = slice(1, -1)  # the end sections are shorter
    # Noise .1 on some 230 points a section: amplitude to .01, so diameters to .02 mm, four of which are allowed for.
    np.testing.assert_allclose(low[inner], 29.4, atol=0.08)
    np.testing.assert_allclose(high[inner], 30.6, atol=0.08)
    scatter = np.std((high - low)[inner])
    assert 0.6 < scatter / np.median(oval.sections.oval_std_mm) < 1.6


def test_a_short_arc_shows_no_ovality_of_sections():
    sections = measure_cable(bent_cable(arc_deg=120.0)).sections
    assert np.isnan(sections.minimum_mm).all()
    assert np.isnan(sections.maximum_mm).all()


def test_free_form_section_of_an_ellipse(oval):
    free = oval.free_section
    # r = 15 + .3 cos 2a: widths across are 2 r to first order; the perimeter of such a curve by its own integral.
    a = np.linspace(0, 2 * np.pi, 20_001)
    r, slope = 15 + 0.3 * np.cos(2 * a), -0.6 * np.sin(2 * a)
    perimeter = np.trapezoid(np.hypot(r, slope), a)
    assert free.diameter_mm == pytest.approx(perimeter / np.pi, abs=0.012)
    assert free.maximum_mm == pytest.approx(30.6, abs=0.03)
    assert free.minimum_mm == pytest.approx(29.4, abs=0.05)
    assert free.square_mm == pytest.approx((30.6, 29.4), abs=0.04)
    assert (free.std_mm < 0.02).all()


def test_free_form_section_follows_a_flat():
    # A round cable of 15 mm with one side flattened by .5 mm over 40 degrees: no oval can show that.
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(-np.pi, np.pi, 20_000), rng.uniform(0, 400, 20_000)
    wanted = np.minimum(15.0, 14.5 / np.cos(np.clip(angle, -0.6, 0.6)))
    radius = wanted + 0.05 * rng.normal(size=20_000)
    found = measure_cable(np.stack([along, radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    free = found.free_section
    # Twelve harmonics round the flat's corners off by some hundredths; the robust fit may take its middle for outliers
    # where it lies beyond 4.7 standard deviations of the noise, which the steps on the shape bring back.
    assert free.minimum_mm == pytest.approx(29.5, abs=0.08)
    assert free.maximum_mm == pytest.approx(30.0, abs=0.06)
    depth = 15 - free.radius_mm.min()
    assert depth == pytest.approx(0.5, abs=0.08)


def test_no_free_form_section_of_a_partial_arc():
    assert measure_cable(bent_cable(arc_deg=200.0)).free_section is None


def test_a_round_section_is_not_made_wavy_by_noise():
    free = measure_cable(bent_cable(arc_deg=360.0)).free_section
    # Noise .1 on 6,000 points: each of 24 coefficients to .1 sqrt(2 / 6000) = .0018; shrinking leaves less than all.
    assert np.ptp(free.radius_mm) < 0.02


def test_sections_are_those_of_the_thing_and_not_of_what_lies_beyond(oval):
    s = oval.sections.s_mm
    assert (s >= 0).all()
    assert (s <= oval.length_mm).all()
    some = between(oval.sections, 100.0, 200.0)
    assert 0 < len(some.s_mm) < len(s)
    assert ((some.s_mm >= 0) & (some.s_mm <= 100)).all()
    assert some.diameter_mm[0] == oval.sections.diameter_mm[np.flatnonzero(s >= 100)[0]]
