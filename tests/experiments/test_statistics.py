"""Means and intervals over seeds."""

import math

import pytest

from experiments.statistics import estimate


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
