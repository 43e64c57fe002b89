"""Means and intervals over seeds."""

import math

import pytest

from experiments.analysis.results import Results
from experiments.analysis.statistics import estimate, fluctuation, paired_difference


def test_interval_is_students():
    # Three values 1, 2, 3: standard error 1 / sqrt(3), t(0.975, 2) = 4.302653.
    result = estimate([1.0, 2.0, 3.0])
    assert result.mean == pytest.approx(2.0)
    assert result.half_width == pytest.approx(4.302653 / math.sqrt(3), rel=1e-6)


def test_one_seed_has_no_interval():
    assert math.isnan(estimate([1.0]).half_width)


def test_nothing_is_refused():
    with pytest.raises(ValueError, match="values"):
        estimate([])


def test_paired_difference_is_students_t_of_the_differences():
    # Differences 1, 2, 3: t = 2 / (1 / sqrt(3)) = 3.4641, p = 0.0742 with 2 degrees of freedom.
    difference, p = paired_difference([2.0, 4.0, 6.0], [1.0, 2.0, 3.0])
    assert difference.mean == pytest.approx(2.0)
    assert p == pytest.approx(0.0742, abs=1e-4)
    with pytest.raises(ValueError, match="expected 2 values"):
        paired_difference([1.0, 2.0], [1.0])


def test_fluctuation_sees_jumps_and_no_slope():
    assert fluctuation([8.0, 7.0, 6.0, 5.0, 4.0, 3.0]) == pytest.approx(0.0)
    # Alternating by 1 about a line: each value lies 2/3 from the mean of three.
    assert fluctuation([0.0, 1.0, 0.0, 1.0, 0.0, 1.0]) == pytest.approx(2 / 3)
    assert math.isnan(fluctuation([1.0, 2.0, 3.0]))


def test_seconds_of_a_cell_are_the_least_of_its_seeds():
    runs = [
        {"cell": {"filter.name": name}, "metrics": {"s": {"warm": s}}} for name, s in (("a", 3), ("a", 2), ("b", 1))
    ]
    results = Results({"experiment": "e", "runs": runs, "config": {}})
    assert results.least("s.warm", filter__name="a") == 2.0
    with pytest.raises(KeyError, match="no run"):
        results.least("s.warm", filter__name="c")
