"""The whole measurement on scans with known truth: diameter, interval, ovality, bend, length, and what is the cable."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.measure import MeasureSettings, measure_cable
from cablejax.types import PointCloud
from tests.reference.circles import bent_cable, cylinder_by_scipy, tube_distance


@pytest.fixture(scope="module")
def half():
    return measure_cable(bent_cable())


def test_half_arc_is_the_diameter_within_its_interval(half):
    # Noise .1 on 6,000 points over a half arc: standard deviation .005 mm of the diameter by the fit's own statistics.
    assert half.diameter_mm == pytest.approx(30, abs=0.02)
    assert half.interval_mm[0] < 30 < half.interval_mm[1]
    assert 0.0045 < half.std_mm < 0.035  # nor is it known whether the points come from stations that are shifted
    assert half.noise_mm == pytest.approx(0.1, rel=0.05)
    assert half.length_mm == pytest.approx(400, abs=0.5)
    assert half.bend_radius_mm is None
    assert half.keep.mean() > 0.99


def test_agrees_with_a_general_optimiser_on_a_straight_cable(half):
    xyz = bent_cable()
    expected = 2 * cylinder_by_scipy(xyz, np.array([0.0, 0, 0, 0, 14.0]))[4]
    # Tukey's weights and an axis free to bend differ from plain least squares by less than a standard deviation.
    assert half.diameter_mm == pytest.approx(expected, abs=2 * half.std_mm)


@pytest.mark.parametrize(("arc_deg", "tolerance"), [(60.0, 0.25), (90.0, 0.1), (360.0, 0.01)])
def test_short_arcs_widen_the_interval_and_do_not_move_the_diameter(arc_deg, tolerance, half):
    result = measure_cable(bent_cable(arc_deg=arc_deg))
    assert result.diameter_mm == pytest.approx(30, abs=tolerance)
    assert (result.std_mm > half.std_mm) == (arc_deg < 180)
    assert abs(result.diameter_mm - 30) < 3 * result.std_mm
    assert (result.ovality is None) == (arc_deg < 175)


@pytest.mark.parametrize("seed", [3, 6, 8, 10])
def test_short_arc_of_a_bend_is_found(seed):
    # Longer pieces of it lie on cylinders two to five times as wide, to a tenth of their radius.
    result = measure_cable(bent_cable(arc_deg=60.0, bend_radius=450.0, noise=0.05, seed=seed))
    assert abs(result.diameter_mm - 30) < 3 * result.std_mm
    assert result.std_mm < 0.1


def test_strays_do_not_lengthen_the_arc():
    rng = np.random.default_rng(0)
    outward = np.stack([np.zeros(1200), *rng.normal(size=(2, 1200))], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    stray = rng.uniform(0, 400, 1200)[:, None] * [1.0, 0.0, 0.0] + (15 + rng.exponential(5, (1200, 1))) * outward
    result = measure_cable(np.concatenate([bent_cable(arc_deg=60.0, noise=0.6), stray]))
    assert result.arc_deg == pytest.approx(60, abs=10)  # single sections show 110 degrees
    assert abs(result.diameter_mm - 30) < 3 * result.std_mm


def test_bend_is_followed_and_its_radius_found():
    xyz = bent_cable(bend_radius=450.0, length=600.0, n=9000)
    result = measure_cable(xyz)
    assert result.diameter_mm == pytest.approx(30, abs=0.02)
    assert result.bend_radius_mm == pytest.approx(450, rel=0.05)
    assert result.bend_interval_mm[0] < 450 < result.bend_interval_mm[1]
    # The deviation of each point is its distance from the true tube, to the accuracy of the fitted axis.
    np.testing.assert_allclose(result.deviation_mm, tube_distance(xyz, 450.0, 15.0), atol=0.05)


def test_oval_section_gives_both_diameters_and_the_mean():
    result = measure_cable(bent_cable(oval=0.3, arc_deg=360.0))
    assert result.diameter_mm == pytest.approx(30, abs=0.02)
    assert result.minimum_mm == pytest.approx(29.4, abs=0.02)
    assert result.maximum_mm == pytest.approx(30.6, abs=0.03)  # 4 standard deviations of the amplitude
    assert result.ovality == pytest.approx(1.2 / 30, rel=0.02)


def test_outliers_and_a_floor_are_left_out():
    rng = np.random.default_rng(1)
    floor = np.stack([rng.uniform(-300, 700, 9000), rng.uniform(-500, 500, 9000), np.full(9000, -25.0)], axis=1)
    dust = rng.uniform(-200, 500, size=(600, 3))
    result = measure_cable(np.vstack([bent_cable(), floor + 0.1 * rng.normal(size=floor.shape), dust]))
    assert result.diameter_mm == pytest.approx(30, abs=0.03)
    assert result.keep[:6000].mean() > 0.98
    assert result.keep[6000:].mean() < 0.005


@pytest.mark.parametrize("seed", [1, 2])
def test_what_lies_on_the_surface_beyond_an_end_is_left_out(seed):
    cable = bent_cable(length=300.0, seed=seed)
    patch = bent_cable(length=12.0, arc_deg=25.0, n=150, seed=seed + 9) * [1, -1, -1] + [303.0, 0, 0]  # a table's edge
    result = measure_cable(np.concatenate([cable, patch]))
    assert result.length_mm == pytest.approx(300.0, abs=2.0)
    assert result.keep[: len(cable)].mean() > 0.99
    assert not result.keep[len(cable) :].any()


def test_place_in_space_does_not_matter(half):
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    moved = measure_cable(bent_cable() @ rotation.T + [4e5, 5.6e6, 300])  # the size of UTM coordinates, in float64
    assert moved.diameter_mm == pytest.approx(half.diameter_mm, abs=half.std_mm)
    assert moved.length_mm == pytest.approx(half.length_mm, abs=0.1)
    middle = moved.axis_mm[len(moved.axis_mm) // 2]
    np.testing.assert_allclose(middle, rotation @ [200, 0, 0] + [4e5, 5.6e6, 300], atol=1.5)


def test_invalid_rows_and_padding_change_nothing(half):
    xyz = bent_cable()
    broken = np.insert(xyz, [0, 3000], np.nan, axis=0)
    result = measure_cable(broken)
    assert result.diameter_mm == half.diameter_mm
    assert result.keep.shape == (6002,)
    assert not result.keep[[0, 3001]].any()
    padded = PointCloud(jnp.pad(jnp.asarray(xyz, jnp.float32), ((0, 7), (0, 0))), jnp.arange(6007) < 6000)
    # float32 coordinates of a few hundred mm are rounded to 3e-5.
    assert measure_cable(padded).diameter_mm == pytest.approx(half.diameter_mm, abs=1e-3)


def test_budget_adds_up_and_takes_what_is_given(half):
    given = MeasureSettings(registration_std_mm=0.03, scale_std=1e-3, filter_std_mm=0.01)
    result = measure_cable(bent_cable(), settings=given)
    budget = {line.source: line.std_mm for line in result.budget}
    assert budget["registration of the stations"] > 0.01
    assert budget["scale calibration"] == pytest.approx(0.03, rel=0.01)
    assert budget["filter bias"] == 0.01
    assert result.std_mm == pytest.approx(np.sqrt(sum(std**2 for std in budget.values())))
    assert result.std_mm > half.std_mm


def test_catalogue_gives_the_size(half):
    result = measure_cable(bent_cable(), catalogue={"95": 27.9, "120": 30.0, "150": 31.5})
    assert result.verdict == "120"
    assert result.nominal["120"] > 0.999
    assert half.verdict is None


def test_result_is_json(half):
    text = json.dumps(half.to_dict(arrays=True), allow_nan=False)
    back = json.loads(text)
    assert back["diameter_mm"] == half.diameter_mm
    assert len(back["deviation_mm"]) == 6000


def test_same_scan_same_result(half):
    assert measure_cable(bent_cable()).diameter_mm == half.diameter_mm
