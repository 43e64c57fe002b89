"""The catalogue against IEC 60502-2 worked by hand, and the size verdict."""

import math

import numpy as np
import pytest

from cablejax.simulate import catalogue, nominal_probabilities
from cablejax.simulate.catalogue import tenth


def test_two_cables_by_hand():
    cables = {cable.size_mm2: cable for cable in catalogue()}
    # 25 mm2: 5.6 + 2 x 4.5 + 3.0 + 0.5 = 18.1; 0.035 x 18.1 + 1.0 = 1.6335 -> 1.6; 18.1 + 3.2
    assert (cables[25].sheath_mm, cables[25].diameter_mm) == (1.6, 21.3)
    # 630 mm2: 28.3 + 9.0 + 3.5 = 40.8; 0.035 x 40.8 + 1.0 = 2.428 -> 2.4; 40.8 + 4.8
    assert (cables[630].sheath_mm, cables[630].diameter_mm) == (2.4, 45.6)


def test_sizes_grow_and_are_named_apart():
    for voltage, count in {"6/10": 13, "8.7/15": 13, "12/20": 12, "18/30": 11}.items():
        cables = catalogue(voltage)
        assert len(cables) == len({cable.name for cable in cables}) == count
        steps = np.diff([cable.diameter_mm for cable in cables])
        assert steps.min() > 1.0
        assert steps.max() < 3.6


def test_halves_round_up():
    assert [tenth(x) for x in (1.25, 1.35, 1.6499, 2.05)] == [1.3, 1.4, 1.6, 2.1]


def test_probability_of_two_equal_neighbours():
    small, large = catalogue()[:2]
    middle = 0.5 * (small.diameter_mm + large.diameter_mm)
    p = nominal_probabilities(middle, 0.1, catalogue())
    assert p[small.name] == pytest.approx(0.5, abs=1e-6)
    assert p[large.name] == pytest.approx(0.5, abs=1e-6)
    # one standard deviation towards the larger: the odds are exp(step / std)
    shifted = nominal_probabilities(middle + 0.1, 0.1, (small, large))
    step = large.diameter_mm - small.diameter_mm
    assert shifted[large.name] / shifted[small.name] == pytest.approx(math.exp(step / 0.1), rel=1e-6)


def test_probability_far_from_every_size_is_finite():
    p = nominal_probabilities(25_000.0, 0.01, catalogue())
    assert sum(p.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("arguments", "word"), [((float("nan"), 1.0), "diameter_mm"), ((30.0, 0.0), "std_mm"), ((30.0, math.inf), "std_mm")]
)
def test_probability_refuses(arguments, word):
    with pytest.raises(ValueError, match=word):
        nominal_probabilities(*arguments, catalogue())


def test_unknown_voltage():
    with pytest.raises(ValueError, match=r"voltage: expected one of 6/10.*got '1/3'"):
        catalogue("1/3")
