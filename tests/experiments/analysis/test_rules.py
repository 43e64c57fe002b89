"""The verdict rules on made-up results: each of the five words comes out, from data that a reader can check by eye."""

import numpy as np
import pytest

from experiments.analysis import rules
from experiments.analysis.inference import Comparison, Interval, compare, compare_all

SEEDS = 10
NOISE = np.random.default_rng(0).normal(0.0, 0.01, (5, SEEDS))  # accuracy from seed to seed


def arm(accuracy: float, row: int = 0, spread: float = 1.0) -> list[float]:
    return (accuracy + spread * NOISE[row]).tolist()


OWN = arm(0.97)
WORSE, BETTER, SAME = arm(0.90, 1), arm(0.995, 2, 0.2), arm(0.97, 0, 0.98)
WILD = [0.99, 0.13, 0.98, 0.97, 0.99, 0.97, 0.96, 0.1, 0.99, 0.98]  # two of ten collapse


@pytest.mark.parametrize(
    ("rivals", "word"),
    [
        ({"a": WORSE, "b": arm(0.92, 3), "c": arm(0.5, 4)}, rules.REPRODUCED),
        ({"a": WORSE, "b": SAME}, rules.IN_PART),
        ({"a": WORSE, "b": BETTER}, rules.IN_PART),
        ({"a": BETTER}, rules.NOT_REPRODUCED),
        ({"a": SAME}, rules.NOT_REPRODUCED),
        ({"a": SAME, "b": WILD}, rules.NOT_REPRODUCED),
        ({"a": WILD}, rules.INCONCLUSIVE),
        ({"a": arm(0.965, 1, 3.0)}, rules.INCONCLUSIVE),
        ({}, rules.CANNOT_BE),
    ],
)
def test_each_word_comes_out(rivals: dict[str, list[float]], word: str):
    assert rules.verdict(compare_all(OWN, rivals).values()) == word


def test_too_few_seeds_show_nothing():
    """Three seeds that all agree: 2 of 8 assignments of signs are as extreme, so p is 0.25."""
    assert rules.verdict([compare([0.9, 0.9, 0.9], [0.5, 0.51, 0.52])]) == rules.INCONCLUSIVE


def test_a_sure_effect_within_the_margin_is_nil():
    tiny = Comparison(Interval(0.005, 0.004, 0.006), 0.002, SEEDS)
    assert rules.outcome(tiny, margin=0.01) == rules.NIL
    assert rules.outcome(tiny, margin=0.001) == rules.HOLDS


def test_many_comparisons_must_hold_together():
    """Seven of eight pairs won, one lost badly: p alone .05 or less would do, among twenty it does not."""
    edge = [0.02, 0.021, 0.019, 0.02, 0.022, 0.018, 0.02, 0.0]
    own, zero = [0.9 + each for each in edge], [0.9] * len(edge)
    alone = compare_all(own, {"a": zero})
    among = compare_all(own, {str(i): zero for i in range(20)})
    assert rules.verdict(alone.values()) == rules.REPRODUCED
    assert rules.verdict(among.values()) == rules.INCONCLUSIVE
