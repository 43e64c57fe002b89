"""Search and labels together: which candidate is told, that both are named, and what the network is never asked."""

import re

import numpy as np
import pytest

from cablejax.measure import MeasureError, PointLabels, measure_cable, measure_labelled
from tests.reference.circles import bent_cable

WIDE, THIN = 60.0, 24.0  # mm; apart by more than either's length
KNOWN = (10.0, 60.0)
N = 1500


@pytest.fixture(scope="module")
def scan() -> np.ndarray:
    """A cylinder of 60 mm, which the search prefers for its points, and 200 mm beside it one of 24 mm."""
    wide = bent_cable(n=N, radius=WIDE / 2, arc_deg=200, seed=1)
    thin = bent_cable(n=N // 3, radius=THIN / 2, arc_deg=200, seed=2) + np.array([0.0, 200.0, 0.0])
    return np.concatenate([wide, thin])


THICK = np.arange(N + N // 3) < N


def labels(
    on_cable: np.ndarray, on_accessory: np.ndarray | None = None, known: tuple[float, float] = KNOWN
) -> PointLabels:
    nothing = np.zeros(len(on_cable), bool)
    return PointLabels(on_cable, nothing if on_accessory is None else on_accessory, known)


def test_labels_that_say_another_thing_is_the_cable_are_told_beside_the_search(scan):
    found = measure_labelled(scan, lambda: labels(~THICK))
    assert found.taken == "labels"
    assert found.by_search.diameter_mm == pytest.approx(WIDE, rel=0.01)
    assert found.result.diameter_mm == pytest.approx(THIN, rel=0.01)
    told = re.search(
        r"Two candidates: .* finds 60\S* mm, .* 24\S* mm\. The latter is told, .* 0 % ", found.result.warnings[-1]
    )
    assert told, found.result.warnings
    same = measure_cable(scan, labels=labels(~THICK))
    assert (same.diameter_mm, same.warnings) == (found.result.diameter_mm, found.result.warnings)


def test_a_size_that_the_network_has_never_seen_is_named_and_not_told(scan):
    found = measure_labelled(scan, lambda: labels(~THICK, known=(30.0, 60.0)))
    assert found.taken == "search"
    assert found.result.diameter_mm == found.by_search.diameter_mm
    assert re.search(r"60\S* mm, .* 24\S* mm\. The former is told", found.result.warnings[-1])


def test_a_cable_that_the_labels_confirm_stays(scan):
    """The labels take the thin one and, of the search's, two points of three for a cable's."""
    found = measure_labelled(scan, lambda: labels(~THICK | (np.arange(len(scan)) % 3 > 0)))
    assert found.taken == "search"
    assert found.result.diameter_mm == found.by_search.diameter_mm == pytest.approx(WIDE, rel=0.01)


@pytest.mark.parametrize(
    "on_cable", [THICK, np.zeros(len(THICK), bool), np.arange(len(THICK)) < 30], ids=["same", "none", "few"]
)
def test_labels_that_agree_or_show_nothing_change_nothing(scan, on_cable):
    found, plain = measure_labelled(scan, lambda: labels(on_cable)), measure_cable(scan)
    assert found.taken == "search"
    assert found.by_labels is None
    assert (found.result.diameter_mm, found.result.warnings) == (plain.diameter_mm, plain.warnings)


def test_what_is_labelled_a_joint_is_called_one(scan):
    found = measure_labelled(scan, lambda: labels(np.zeros(len(scan), bool), THICK))
    assert found.result.diameter_mm == pytest.approx(WIDE, rel=0.01)
    assert "labelled as a joint's" in found.result.warnings[-1]


def never() -> PointLabels:
    raise AssertionError("the network was asked")


def test_a_cable_by_itself_and_a_refused_scan_need_no_network(scan):
    alone = scan[:N]
    assert measure_labelled(alone, never).result.diameter_mm == pytest.approx(WIDE, rel=0.01)
    flat = np.random.default_rng(0).uniform(0, 100, (500, 3)) * [1, 1, 0]
    with pytest.raises(MeasureError):
        measure_labelled(flat, never)


def test_labels_are_checked(scan):
    with pytest.raises(ValueError, match=r"labels\.on_cable: expected 2000 truth values, got \[7\]"):
        measure_cable(scan, labels=labels(np.zeros(7, bool)))
    with pytest.raises(ValueError, match=r"labels\.on_accessory: expected 2000 truth values"):
        measure_cable(scan, labels=labels(THICK, np.zeros(3, bool)))
    with pytest.raises(ValueError, match="labels: expected none beside on_cable"):
        measure_cable(scan, on_cable=THICK, labels=labels(THICK))
