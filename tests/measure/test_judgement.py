"""What is said of a measurement: within limits or not, bent too tightly or not, where the diameter leaves its mean."""

import numpy as np
import pytest

from cablejax.measure import Sections, bend_conformity, conformity, irregularities


def sections(diameter: np.ndarray, std: float = 0.01) -> Sections:
    n = len(diameter)
    wide = np.full(n, 180.0), np.full(n, 100.0), diameter - 0.1, diameter + 0.1, np.full(n, std)
    return Sections(np.arange(n) * 5.0, diameter, np.full(n, std), *wide)


@pytest.mark.parametrize(
    ("value", "expected"), [(30.0, "pass"), (30.40, "pass"), (30.45, "undecided"), (30.55, "undecided"), (30.6, "fail")]
)
def test_limits_with_their_guard_bands(value, expected):
    assert conformity(value, 0.05, low=29.5, high=30.5) == expected


def test_one_sided_limits_and_wrong_ones():
    assert conformity(30.0, 0.1, low=-np.inf, high=31.0) == "pass"
    with pytest.raises(ValueError, match="low: expected less than high, 29, got 31"):
        conformity(30.0, 0.1, low=31.0, high=29.0)
    with pytest.raises(ValueError, match="std: expected a positive"):
        conformity(30.0, 0.0, low=29.0, high=31.0)


def test_bends():
    assert bend_conformity(None, 30.0) == {"12 D": "pass", "15 D": "pass", "20 D": "pass"}
    assert bend_conformity((440.0, 460.0), 30.0) == {"12 D": "pass", "15 D": "undecided", "20 D": "fail"}


def test_an_even_cable_has_no_irregularities():
    rng = np.random.default_rng(0)
    assert irregularities(sections(30 + 0.01 * rng.normal(size=80))) == []
    assert irregularities(sections(np.full(5, 30.0))) == []


def test_a_dent_and_a_step_are_found_where_they_are():
    rng = np.random.default_rng(0)
    diameter = 30 + 0.01 * rng.normal(size=80)
    diameter[20:23] -= 0.6
    diameter[55:] += 1.5
    dent, step = irregularities(sections(diameter))
    assert (dent.kind, dent.from_mm, dent.to_mm) == ("dent", 100.0, 110.0)
    assert dent.change_mm == pytest.approx(-0.6, abs=0.05)
    assert step.kind == "step up"
    assert step.from_mm <= 275.0 <= step.to_mm
    assert step.change_mm == pytest.approx(1.5, abs=0.1)


def test_undefined_and_uncertain_sections_are_passed_over():
    diameter = np.full(60, 30.0)
    diameter[10] = np.nan
    wide = sections(diameter)
    wide.std_mm[30] = 2.0
    wide.diameter_mm[30] = 35.0
    assert irregularities(wide) == []
