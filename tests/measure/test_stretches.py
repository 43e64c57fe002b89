"""A thing of several diameters is told as what it is: stretches, tapers, steps."""

import numpy as np
import pytest

from cablejax.measure import MeasureError, measure_cable
from cablejax.measure.shape.profile import Profile
from cablejax.measure.shape.stretches import ONE, Stretch, changes, form_of, mean_of, stretches_of, within

NOISE = 0.05


def revolved(
    corners: list[tuple[float, float]],
    *,
    arc_deg: float = 180.0,
    n: int = 12_000,
    oval: float = 0.0,
    inner: float = 0.0,
) -> np.ndarray:
    """Points of a body of revolution about x, its outline through corners of place and radius; `inner` is the share of
    points on a wall at .8 of the radius."""
    rng = np.random.default_rng(0)
    along = rng.uniform(0, corners[-1][0], n)
    angle = np.radians(rng.uniform(-arc_deg / 2, arc_deg / 2, n))
    radius = np.interp(along, *zip(*corners, strict=True)) * (1 + 0.5 * oval * np.cos(2 * angle))
    radius = np.where(rng.uniform(size=n) < inner, 0.8 * radius, radius) + NOISE * rng.normal(size=n)
    return np.stack([along, radius * np.sin(angle), radius * np.cos(angle)], axis=1)


def profile(diameter: np.ndarray, std: float) -> Profile:
    s = 5.0 * np.arange(len(diameter))
    return Profile(s, diameter, np.full(len(s), std), np.zeros((len(s), 2)), 5.0)


def test_a_joint_is_five_stretches():
    joint = [(0.0, 15.0), (140.0, 15.0), (160.0, 27.0), (300.0, 27.0), (320.0, 15.0), (460.0, 15.0)]
    found = measure_cable(revolved(joint, n=24_000))
    kinds = [one.kind for one in found.stretches]
    assert kinds == ["constant", "tapering", "constant", "tapering", "constant"]
    cable, _, barrel, _, behind = found.stretches
    for one, diameter, length in ((cable, 30.0, 140.0), (barrel, 54.0, 140.0), (behind, 30.0, 140.0)):
        assert abs(one.first_mm - diameter) < 3 * one.std_mm
        assert one.std_mm < 0.05
        assert one.length_mm == pytest.approx(length, abs=10.0)  # a section is 6.75 mm long
    assert found.irregularities == []
    assert found.diameter_mm == pytest.approx(54.0, abs=0.1)  # of the barrel, which holds most points


@pytest.mark.parametrize("arc_deg", [120.0, 360.0])
def test_a_step_of_a_twentieth_is_reported(arc_deg):
    found = measure_cable(revolved([(0.0, 27.5), (100.0, 27.5), (100.01, 28.7), (200.0, 28.7)], arc_deg=arc_deg))
    assert found.form.startswith("not one diameter: 5")
    assert found.form.endswith("in 2 stretches")
    (step,) = found.irregularities
    assert step.change_mm * (1 if step.kind == "step up" else -1) == pytest.approx(2.4, abs=0.3)
    assert found.interval_mm[0] < 55.0 < 57.4 < found.interval_mm[1]
    assert any("not one diameter" in text for text in found.warnings)


def test_a_taper_is_told_from_end_to_end():
    found = measure_cable(revolved([(0.0, 55.0), (3000.0, 37.5)]))
    assert found.form.startswith("tapers from ")
    ends = sorted(float(word) for word in found.form.replace("tapers from ", "").replace(" mm", "").split(" to "))
    assert ends == pytest.approx([75.0, 110.0], abs=0.5)
    assert found.diameter_mm == pytest.approx(92.5, abs=0.5)
    assert found.to_dict()["stretches"][0]["kind"] == "tapering"


@pytest.mark.parametrize("arc_deg", [90.0, 180.0, 360.0])
def test_an_even_cable_is_one_stretch(arc_deg):
    found = measure_cable(revolved([(0.0, 15.0), (400.0, 15.0)], arc_deg=arc_deg))
    assert found.form == ONE
    (only,) = found.stretches
    assert only.length_mm == pytest.approx(400.0, abs=12.0)
    assert found.irregularities == []


def test_ovality_of_a_tenth_is_given_as_ovality():
    found = measure_cable(revolved([(0.0, 15.0), (400.0, 15.0)], arc_deg=360.0, oval=0.1))
    assert found.ovality == pytest.approx(0.1, abs=0.005)
    assert found.form == ONE


def test_an_inner_wall_does_not_move_the_outer_one():
    found = measure_cable(revolved([(0.0, 15.0), (400.0, 15.0)], arc_deg=360.0, inner=0.3))
    assert abs(found.diameter_mm - 30.0) < 3 * found.std_mm
    assert found.std_mm < 0.1


def test_a_solid_of_points_and_a_fold_are_no_cable():
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 9000), 15 * np.sqrt(rng.uniform(size=9000))
    solid = np.stack([rng.uniform(0, 300, 9000), radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    with pytest.raises(MeasureError, match="No cable found"):
        measure_cable(solid)
    side = rng.uniform(-30, 30, 9000)
    fold = np.stack([rng.uniform(0, 300, 9000), side, -np.abs(side)], axis=1) + NOISE * rng.normal(size=(9000, 3))
    with pytest.raises(MeasureError, match="No cable found"):
        measure_cable(fold)


def test_noise_makes_no_stretches():
    rng = np.random.default_rng(1)
    numbers = [len(stretches_of(profile(30 + 0.1 * rng.normal(size=60), 0.1), common_std_mm=0.0)) for _ in range(40)]
    assert numbers == [1] * 40


def test_uncertainty_that_all_share_does_not_hide_a_step():
    d = np.where(np.arange(40) < 20, 30.0, 31.0) + 0.02 * np.random.default_rng(2).normal(size=40)
    found = stretches_of(profile(d, 0.02), common_std_mm=1.0)
    assert all(one.std_mm > 0.95 for one in found)
    ((at, size, std),) = changes(found)
    assert at == pytest.approx(97.5)
    assert size == pytest.approx(1.0, abs=0.05)
    assert std < 0.5


def test_parts_and_means_of_stretches():
    two = (Stretch("constant", 0.0, 60.0, 30.0, 30.0, 0.1), Stretch("tapering", 60.0, 100.0, 30.0, 50.0, 0.1))
    mean, spread = mean_of(two)
    assert mean == pytest.approx(0.6 * 30 + 0.4 * 40)
    assert spread == pytest.approx(np.sqrt(0.6 * 900 + 0.4 * (2500 + 1500 + 900) / 3 - mean**2))
    (part,) = within(two, 80.0, 100.0)
    assert (part.first_mm, part.last_mm) == (40.0, 50.0)
    assert form_of(two[1:]) == "tapers from 30 to 50 mm"
