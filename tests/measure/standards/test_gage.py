"""The gage study against AIAG's own worked example and against variances that are known."""

import numpy as np
import pytest

from cablejax.measure.standards import gage_study
from cablejax.measure.standards.gage import anova

# AIAG MSA, 4th edition, Figure III-B 15: three appraisers, ten parts, three trials.
AIAG = np.array(
    [
        [[0.29, 0.41, 0.64], [0.08, 0.25, 0.07], [0.04, -0.11, -0.15]],
        [[-0.56, -0.68, -0.58], [-0.47, -1.22, -0.68], [-1.38, -1.13, -0.96]],
        [[1.34, 1.17, 1.27], [1.19, 0.94, 1.34], [0.88, 1.09, 0.67]],
        [[0.47, 0.50, 0.64], [0.01, 1.03, 0.20], [0.14, 0.20, 0.11]],
        [[-0.80, -0.92, -0.84], [-0.56, -1.20, -1.28], [-1.46, -1.07, -1.45]],
        [[0.02, -0.11, -0.21], [-0.20, 0.22, 0.06], [-0.29, -0.67, -0.49]],
        [[0.59, 0.75, 0.66], [0.47, 0.55, 0.83], [0.02, 0.01, 0.21]],
        [[-0.31, -0.20, -0.17], [-0.63, 0.08, -0.34], [-0.46, -0.56, -0.49]],
        [[2.26, 1.99, 2.01], [1.80, 2.12, 2.19], [1.77, 1.45, 1.87]],
        [[-1.36, -1.25, -1.31], [-1.68, -1.62, -1.50], [-1.49, -1.77, -2.16]],
    ]
)


def test_the_worked_example_of_aiag():
    squares, freedom = anova(AIAG)
    assert squares == pytest.approx((88.3619, 3.1673, 0.3590, 2.7589), abs=5e-5)  # printed to four decimals
    assert freedom == (9, 2, 18, 60)
    study = gage_study(AIAG)
    # As printed, with the interaction pooled; sums there are of rounded numbers.
    assert study.repeatability == pytest.approx(0.199933, abs=1e-6)
    assert study.reproducibility == pytest.approx(0.226838, abs=1e-6)
    assert study.interaction == 0
    assert study.gage == pytest.approx(0.302373, abs=5e-6)
    assert study.part == pytest.approx(1.042327, abs=5e-6)
    assert study.total == pytest.approx(1.085, abs=5e-4)
    assert study.percent_gage == pytest.approx(27.9, abs=0.05)
    assert (study.categories, study.verdict) == (4, "may be acceptable")


@pytest.mark.parametrize("interaction", [0.0, 0.3])
def test_components_are_those_that_were_put_in(interaction):
    rng = np.random.default_rng(2)
    p, o, t = 400, 40, 3
    values = (
        rng.normal(0, 1.0, (p, 1, 1)) + rng.normal(0, 0.5, (1, o, 1)) + rng.normal(0, interaction, (p, o, 1))
        + rng.normal(0, 0.2, (p, o, t))
    )  # fmt: skip
    study = gage_study(values, tolerance=6.0)
    # A standard deviation from n values is known to 1 / sqrt(2 n); three times that is allowed.
    assert study.part == pytest.approx(1.0, rel=3 / np.sqrt(2 * p))
    assert study.reproducibility == pytest.approx(np.hypot(0.5, interaction), rel=3 / np.sqrt(2 * o))
    assert study.repeatability == pytest.approx(0.2, rel=3 / np.sqrt(2 * p * o))
    # Mean squares of interaction and error are known to sqrt(2 / freedom): three times that, in the variance.
    chance = 3 * 0.2**2 / t * np.hypot(np.sqrt(2 / (p * o)), np.sqrt(2 / (p * o * (t - 1))))
    assert study.interaction == pytest.approx(interaction, rel=3 / np.sqrt(2 * p * o), abs=np.sqrt(chance))
    assert study.percent_tolerance == pytest.approx(100 * study.gage)


def test_one_operator_and_one_part():
    rng = np.random.default_rng(3)
    parts = rng.normal(0, 1, (50, 1, 1))
    study = gage_study(parts + rng.normal(0, 0.1, (50, 1, 4)))
    assert (study.reproducibility, study.interaction_p) == (0, None)
    assert study.repeatability == pytest.approx(0.1, rel=0.2)
    alone = gage_study(rng.normal(0, 0.1, (1, 1, 200)), tolerance=1.2)
    assert (alone.part, alone.categories, alone.verdict) == (0, 0, "unacceptable")
    assert alone.percent_tolerance == pytest.approx(50, rel=0.2)


@pytest.mark.parametrize(
    ("values", "tolerance", "text"),
    [
        (
            np.zeros((3, 3, 1)),
            None,
            "values: expected .parts, operators, trials. with two trials or more, got .3, 3, 1",
        ),
        (np.zeros((3, 3, 2)), None, "values: expected numbers that differ"),
        (np.full((2, 2, 2), np.nan), None, "values: expected finite numbers, got 8"),
        (AIAG, 0.0, "tolerance: expected a positive number, got 0"),
    ],
)
def test_what_is_no_study_is_named(values, tolerance, text):
    with pytest.raises(ValueError, match=text):
        gage_study(values, tolerance=tolerance)
