"""The catalogue against IEC 60502-2 worked by hand, and the size verdict."""

import math

import numpy as np
import pytest

from cablejax.simulate import catalogue, nominal_probabilities, read_catalogue
from cablejax.simulate.nominal import tenth


def test_two_cables_by_hand():
    cables = {cable.size_mm2: cable for cable in catalogue()}
    # 25 mm2: 5.6 + 2 x 4.5 + 3.0 + 0.5 = 18.1; 0.035 x 18.1 + 1.0 = 1.6335 -> 1.6; 18.1 + 3.2
    assert (cables[25].sheath_mm, cables[25].diameter_mm) == (1.6, 21.3)
    # 630 mm2: 28.3 + 9.0 + 3.5 = 40.8; 0.035 x 40.8 + 1.0 = 2.428 -> 2.4; 40.8 + 4.8
    assert (cables[630].sheath_mm, cables[630].diameter_mm) == (2.4, 45.6)


def test_another_voltage_by_hand():
    cables = {cable.size_mm2: cable for cable in catalogue("3.6/6")}
    # 300 mm2: 19.5 + 2 x 2.8 + 3.0 + 0.5 = 28.6; 0.035 x 28.6 + 1.0 = 2.001 -> 2.0; 28.6 + 4.0
    assert (cables[300].insulation_mm, cables[300].diameter_mm) == (2.8, 32.6)
    assert all("IEC 60502-2" in cable.source for cable in cables.values())
    assert all("wires" in cable.source for cable in catalogue(armoured=True))


def test_sizes_grow_and_are_named_apart():
    for voltage, count in {"3.6/6": 13, "6/10": 13, "8.7/15": 13, "12/20": 12, "18/30": 11}.items():
        cables = catalogue(voltage)
        assert len(cables) == len({cable.name for cable in cables}) == count
        steps = np.diff([cable.diameter_mm for cable in cables])
        assert steps.min() > 1.0
        assert steps.max() < 3.8


def test_armoured_cable_by_hand():
    cables = {cable.size_mm2: cable for cable in catalogue(armoured=True)}
    # 240 mm2: 17.5 + 9.0 + 3.5 = 30.0 under; bedding max(1.2, 1.2) -> 32.4; wires 2.0 -> 36.4;
    # sheath 0.035 x 36.4 + 1.0 = 2.274 -> 2.3 -> 41.0
    assert (cables[240].sheath_mm, cables[240].diameter_mm) == (2.3, 41.0)
    # 25 mm2: 18.1 + 2.4 = 20.5; wires 1.6 -> 23.7; sheath 1.83 -> 1.8, which is also the least -> 27.3
    assert (cables[25].sheath_mm, cables[25].diameter_mm) == (1.8, 27.3)


GOOD = "- {name: b, size_mm2: 240, diameter_mm: 35.1, source: s}\n- {name: a, size_mm2: 95, diameter_mm: 27, source: s}"


def test_own_cables_are_sorted_by_diameter(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(GOOD)
    cables = read_catalogue(file)
    assert [cable.name for cable in cables] == ["a", "b"]
    assert cables[0].diameter_mm == 27.0
    assert math.isnan(cables[0].sheath_mm)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected a list of cables, got NoneType"),
        ("a: [", "expected YAML"),
        ("name: a", "expected a list of cables, got dict"),
        ("- 3", "cable 1: expected a mapping, got int"),
        ("- {name: a, size_mm2: 3, source: s}", "cable 1: expected 'diameter_mm'"),
        ("- {name: a, size_mm2: 3, source: s, diameter_mm: wide}", "cable 1, diameter_mm: expected a number above 0"),
        ("- {name: a, size_mm2: 3, source: s, diameter_mm: .nan}", "diameter_mm: expected a number above 0, got nan"),
        ("- {name: a, size_mm2: 3, source: s, diameter_mm: 3, colour: red}", "got 'colour'"),
        (GOOD.replace("name: a", "name: b"), "expected different names, got 'b'"),
    ],
)
def test_own_cables_refused_with_the_place(tmp_path, text, words):
    file = tmp_path / "own.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=f"{file}: .*{words}|{file}: {words}"):
        read_catalogue(file)


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
    with pytest.raises(ValueError, match=r"voltage: expected one of 3.6/6.*got '1/3'"):
        catalogue("1/3")
