"""Scans from one depth image: told by their pixels, a single view, with what lens and blur may have done in the interval."""

from dataclasses import replace

import numpy as np
import pytest

from cablejax.measure import MeasureSettings, measure_cable
from cablejax.measure.depth_image import blurred, pixel_grid, undistorted
from cablejax.measure.fit.axis import Place, bearing, sampled, turns_by
from cablejax.measure.fit.least_squares import CableFit
from cablejax.measure.fit.start import SHARPEST, seen

FOCAL_PX, DISTANCE_MM, RADIUS_MM = 900.0, 500.0, 15.0


def picture(*, distortion: float = 0.0, middle=(0.28, 0.0), noise: float = 0.05) -> np.ndarray:
    """A cylinder along y off the middle of a depth image `[n, 3]`, whose distortion is not taken out."""
    rng = np.random.default_rng(0)
    column, row = np.meshgrid(np.arange(-40, 41), np.arange(-60, 61))
    seen_at = np.stack([column.ravel(), row.ravel()], axis=1) / FOCAL_PX + middle
    ray = undistorted(np.concatenate([seen_at, np.ones((len(seen_at), 1))], axis=1), distortion)[:, :2]
    # Where the ray (x, ., 1) z meets the circle about (a, d): z^2 (1 + x^2) - 2 z (d + a x) + a^2 + d^2 - R^2 = 0.
    a, x = middle[0] * DISTANCE_MM, ray[:, 0]
    half, square = DISTANCE_MM + a * x, 1 + x**2
    inside = half**2 - square * (a**2 + DISTANCE_MM**2 - RADIUS_MM**2)
    hit = inside > 0
    z = (half - np.sqrt(np.maximum(inside, 0))) / square + noise * rng.normal(size=len(x))
    return np.concatenate([seen_at * z[:, None], z[:, None]], axis=1)[hit]


@pytest.mark.parametrize("scale", [1.0, 1e-3, -1.0])
def test_pixels_are_told_in_any_unit_and_on_either_side(scale):
    camera = pixel_grid(picture() * scale)
    assert camera is not None
    assert camera.focal_x_px == pytest.approx(FOCAL_PX, rel=1e-4)
    assert camera.pitch_mm(DISTANCE_MM) == pytest.approx(DISTANCE_MM / FOCAL_PX, rel=1e-4)


def test_float32_and_missing_columns_are_pixels_still():
    xyz = picture().astype(np.float32).astype(float)
    column = np.round(xyz[:, 0] / xyz[:, 2] * FOCAL_PX).astype(int)
    assert pixel_grid(xyz[column % 5 != 0]) is not None


@pytest.mark.parametrize("change", ["moved", "turned", "jittered", "in no order", "few columns"])
def test_what_is_on_no_pixels(change):
    xyz, rng = picture(), np.random.default_rng(1)
    if change == "moved":
        xyz = xyz + np.array([30.0, 0.0, 0.0])
    elif change == "turned":
        c, s = np.cos(0.05), np.sin(0.05)
        xyz = xyz @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
    elif change == "jittered":
        xyz = xyz + rng.normal(size=xyz.shape) * [0.3, 0.3, 0.0]
    elif change == "in no order":
        xyz = rng.uniform([-50, -50, 400], [50, 50, 500], (5000, 3))
    else:
        xyz = xyz[np.argsort(np.abs(xyz[:, 0] / xyz[:, 2] - 0.28))[:300]]
    assert pixel_grid(xyz) is None


def test_taking_a_distortion_out_is_the_inverse_of_brown():
    xyz = picture()
    back = undistorted(xyz, -0.07)
    r2 = np.sum((back[:, :2] / back[:, 2:]) ** 2, axis=1, keepdims=True)
    np.testing.assert_allclose(back[:, :2] * (1 - 0.07 * r2), xyz[:, :2], atol=1e-6)
    np.testing.assert_array_equal(back[:, 2], xyz[:, 2])


@pytest.fixture(scope="module")
def plain():
    return measure_cable(picture())


def test_a_depth_image_is_a_single_view_with_lens_and_blur_in_its_budget(plain):
    budget = {line.source: line for line in plain.budget}
    assert budget["registration of the stations"].std_mm == 0
    # At .28 of the focal length the section is drawn out by 3 k r^2 = 2.4 % across, which by its curvature counts up to twice.
    assert 0.024 < budget["lens distortion of a depth image"].std_mm / plain.diameter_mm < 0.06
    assert budget["blur of a depth image"].std_mm > 0
    assert budget["lens distortion of a depth image"].kind == "B"


def test_a_lens_that_was_left_in_makes_it_wrong_and_the_interval_holds(plain):
    barrel = measure_cable(picture(distortion=-0.07))
    low, high = barrel.interval_mm
    assert low < 2 * RADIUS_MM < high
    # Without the lens in the budget this interval misses, as it did on real scans.
    rectified = measure_cable(picture(distortion=-0.07), settings=MeasureSettings(lens_std=0.0))
    assert not rectified.interval_mm[0] < 2 * RADIUS_MM < rectified.interval_mm[1]
    # In the middle of the picture a lens does nothing to speak of.
    middle = {line.source: line.std_mm for line in measure_cable(picture(middle=(0.0, 0.0))).budget}
    assert middle["lens distortion of a depth image"] < 0.005 * 2 * RADIUS_MM
    assert abs(plain.diameter_mm - 2 * RADIUS_MM) < 3 * plain.std_mm


def test_moved_it_is_no_depth_image():
    sources = [line.source for line in measure_cable(picture() + np.array([30.0, 0, 0])).budget]
    assert "lens distortion of a depth image" not in sources


@pytest.mark.parametrize("wrong", [-0.1, np.nan, np.inf])
def test_lens_std_is_checked(wrong):
    with pytest.raises(ValueError, match="lens_std: expected a number of at least 0"):
        replace(MeasureSettings(), lens_std=wrong)


def test_blur_takes_the_rims():
    aside = np.linspace(-0.9, 0.9, 7) * RADIUS_MM
    np.testing.assert_allclose(blurred(aside, RADIUS_MM, 1e-9), np.sqrt(RADIUS_MM**2 - aside**2), atol=1e-6)
    # On the crest a Gaussian blur lowers a circle by s^2 / 2 R.
    assert blurred(np.zeros(1), RADIUS_MM, 1.0)[0] == pytest.approx(RADIUS_MM - 1 / (2 * RADIUS_MM), abs=1e-3)
    assert (blurred(aside, RADIUS_MM, 2.0) < np.sqrt(RADIUS_MM**2 - aside**2)).all()


def test_the_bearing_of_a_point_is_its_angle_about_the_axis():
    axis = sampled(np.array([[0.0, 0, 0], [100.0, 0, 0]]), step=2.0)
    point = np.array([30.0, 5.0, 12.0])
    middle = np.array([30.0])
    at = axis.across[0] * np.cos(bearing(axis, middle, point)) + np.cross([1.0, 0, 0], axis.across[0]) * np.sin(
        bearing(axis, middle, point)
    )
    np.testing.assert_allclose(at, [0, 5 / 13, 12 / 13], atol=1e-9)


def hooked() -> CableFit:
    """A tube that is straight for 100 mm and then turns by a right angle within half of its diameter."""
    way = np.stack([np.arange(0, 100, 2.0), np.zeros(50), np.zeros(50)], axis=1)
    turn = np.radians(np.arange(0, 91, 10))
    bend = np.stack([100 + 5 * np.sin(turn), 5 * (1 - np.cos(turn)), np.zeros(10)], axis=1)
    rest = np.stack([np.full(12, 105.0), np.arange(7, 31, 2.0), np.zeros(12)], axis=1)
    axis = sampled(np.concatenate([way, bend, rest]), step=2.0)
    rng = np.random.default_rng(0)
    s, angle = rng.uniform(0, axis.s[-1], 4000), rng.uniform(0, np.pi, 4000)
    empty = np.zeros(4000)
    return CableFit(
        axis, 10.0, 0.1, 0.1, 0.1, Place(s, 10 * np.cos(angle), 10 * np.sin(angle)), empty, np.ones(4000), empty
    )


def test_an_axis_ends_where_it_turns_as_no_cable_does():
    fit = hooked()
    turns = turns_by(fit.axis, 20.0)
    assert turns[:40].max() < 0.02
    assert turns.max() > SHARPEST
    low, high = seen(fit)
    assert low < 1.0
    assert 85 < high < 101
