"""The study's statistics against cases worked by hand."""

import itertools
import math

import numpy as np
import pytest

from experiments.analysis import inference
from experiments.analysis.inference import Interval, bootstrap, compare, compare_all, wilson


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # z = 1.959964, z^2 = 3.841459: with 0 of 10 the upper end is z^2 / (10 + z^2).
        (0, 10, 0.0, 3.841459 / 13.841459),
        (10, 10, 10 / 13.841459, 1.0),
        # 5 of 10: middle 1/2, half width z sqrt(1/40 + z^2/400) / (1 + z^2/10).
        (5, 10, 0.5 - 1.959964 * math.sqrt(0.025 + 3.841459 / 400) / 1.3841459, None),
        (1, 1, 1 / 4.841459, 1.0),
    ],
)
def test_wilson(successes: int, n: int, low: float, high: float | None):
    found = wilson(successes, n)
    assert found.value == successes / n
    assert found.low == pytest.approx(low, abs=1e-6)
    assert found.high == pytest.approx(1 - low if high is None else high, abs=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 1000])
def test_no_interval_of_a_share_leaves_its_range(n: int):
    for successes in {0, 1, n // 2, n - 1, n}:
        found = wilson(successes, n)
        assert 0.0 <= found.low <= found.value <= found.high <= 1.0
        accuracy = [1.0] * successes + [0.0] * (n - successes)
        for statistic in (inference.interquartile_mean, inference.mean):
            if n < 100:
                found = bootstrap(accuracy, statistic)
                assert 0.0 <= found.low <= found.high <= 1.0


def test_interquartile_mean_leaves_whole_quarters_out():
    assert inference.interquartile_mean([3.0]) == 3.0
    assert inference.interquartile_mean([0.0, 9.0, 3.0]) == 4.0  # of three no whole quarter
    assert inference.interquartile_mean([5.0, -100.0, 1.0, 2.0, 3.0, 4.0, 6.0, 100.0]) == 3.5
    # The seeds of the published table: .131 beside .981 and .965 with an interval of 1.2 was the mean's.
    assert inference.interquartile_mean([0.981, 0.965, 0.131, 0.97]) == pytest.approx(0.9675)


def test_bootstrap_of_a_mean_is_near_the_normal_interval():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    found = bootstrap(values.tolist(), inference.mean)
    half = 1.96 * values.std() / 20  # the standard error of a mean of 400
    # Of 10,000 resamples the quantiles' own error is a few hundredths of the half width.
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)
    assert bootstrap([0.25]) == Interval(0.25, 0.25, 0.25)
    assert bootstrap(values.tolist()) == bootstrap(values.tolist())


def test_sign_flips_of_ten_seeds():
    # All ten of one sign: of 1,024 assignments two are as extreme.
    assert compare([1.0 + 0.1 * i for i in range(10)], [0.0] * 10).p == pytest.approx(2 / 1024)
    assert compare([1.0, -1.0], [0.0, 0.0]).p == 1.0
    assert compare([0.5] * 4, [0.5] * 4).p == 1.0
    many = compare([1.0] * 40, [0.0] * 40)
    assert many.p == pytest.approx(1 / (inference.RESAMPLES + 1))
    with pytest.raises(ValueError, match="expected 2 values"):
        compare([1.0, 2.0], [1.0])


def test_holm_steps_down():
    # Sorted .005, .01, .03, .04 times 4, 3, 2, 1, never falling.
    adjusted = inference.holm({"d": 0.04, "a": 0.01, "c": 0.03, "b": 0.005})
    assert list(adjusted) == ["d", "a", "c", "b"]
    assert adjusted == pytest.approx({"b": 0.02, "a": 0.03, "c": 0.06, "d": 0.06})
    assert inference.holm({"a": 0.9, "b": 0.8}) == {"a": 1.0, "b": 1.0}
    found = compare_all([1.0, 2.0, 3.0], {"x": [0.0, 1.0, 2.0], "y": [1.0, 2.0, 3.5]})
    assert (found["x"].p, found["y"].p) == (0.5, 1.0)  # .25 twice, 1 once


def test_time_to_target():
    assert inference.epochs_to_target([0.1, 0.95, 0.2, 0.99], 0.95) == 2
    assert inference.epochs_to_target([0.1, 0.2], 0.95) == math.inf


def test_best_of_n_is_the_mean_over_all_draws():
    trials = [0.3, 0.9, 0.1, 0.4]
    expected = [np.mean([max(each) for each in itertools.combinations(trials, n)]) for n in range(1, 5)]
    np.testing.assert_allclose(inference.best_of(trials), expected, rtol=1e-12)


def test_profile_counts_pairs_within_a_factor_of_the_best_arm():
    costs = {
        "quick": {"a": [10.0, 10.0], "b": [40.0, math.inf]},
        "slow": {"a": [20.0, 30.0], "b": [20.0, 20.0]},
    }
    # Least medians: 10 in a, 20 in b. quick: 1, 1, 2, never; slow: 2, 3, 1, 1.
    found = inference.performance_profile(costs, [1.0, 2.0, 3.0])
    assert found == {"quick": [0.5, 0.75, 0.75], "slow": [0.5, 0.75, 1.0]}
    never = inference.performance_profile({"a": {"p": [math.inf]}, "b": {"p": [math.inf]}}, [1.0])
    assert never == {"a": [0.0], "b": [0.0]}
    with pytest.raises(ValueError, match="expected a, b for every arm, got a for slow"):
        inference.performance_profile({"quick": {"a": [1.0], "b": [1.0]}, "slow": {"a": [1.0]}}, [1.0])


@pytest.mark.parametrize(
    "call", [lambda: bootstrap([]), lambda: wilson(0, 0), lambda: wilson(3, 2), lambda: inference.best_of([])]
)
def test_nothing_is_refused(call):
    with pytest.raises(ValueError, match="expected"):
        call()
