"""Coordinates that are multiples of a step: seen, told, and refused where a section has no shape left."""

import numpy as np
import pytest

from cablejax.measure import MeasureError, MeasureSettings, measure_cable
from cablejax.measure.steps import about_steps, coordinate_steps, step_across, too_coarse

DIAMETER = 50.0


def tube(n: int = 8000, *, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    along, angle = rng.uniform(0, 400.0, n), rng.uniform(-np.pi, np.pi, n)
    rough = DIAMETER / 2 + 0.1 * rng.normal(size=n)
    return np.stack([along, rough * np.cos(angle), rough * np.sin(angle)], axis=1)


@pytest.mark.parametrize("step", [(0.5, 0.0, 2.0), (0.0, 0.0, 0.0), (4.0, 4.0, 4.0), (1 / 64, 1 / 3, 1 / 32)])
@pytest.mark.parametrize("shift", [0.0, 12_345.6])
def test_the_step_of_each_coordinate(step, shift):
    xyz, step = tube(), np.array(step)
    written = np.where(step > 0, np.round(xyz / np.where(step > 0, step, 1.0)) * step, xyz) + shift
    seen = np.where(step > 0.02, step, 0.0)  # 1/64 of 400 mm has more values than points
    np.testing.assert_allclose(coordinate_steps(written), seen, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize(
    "none",
    [
        np.zeros((50, 3)),
        np.arange(30.0).reshape(10, 3),
        np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32),
    ],
    ids=["one place", "few", "float32"],
)
def test_no_step(none):
    assert (coordinate_steps(none) == 0).all()


def test_steps_along_the_axis_do_not_count():
    xyz = tube()
    xyz[:, 0] = np.round(xyz[:, 0] / 20) * 20
    assert step_across(xyz, np.array([1.0, 0.0, 0.0])) == pytest.approx(0.0, abs=1e-6)
    assert step_across(xyz, np.array([0.0, 0.0, 1.0])) == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_fine_steps_pass_in_silence_middling_ones_with_a_word_and_coarse_ones_not(seed):
    xyz = tube(seed=seed)
    one_view = MeasureSettings(stations=1)
    fine = measure_cable(np.round(xyz / 0.1) * 0.1, settings=one_view)
    assert fine.interval_mm[0] < DIAMETER < fine.interval_mm[1]
    assert not any("multiples" in warning for warning in fine.warnings)
    middling = measure_cable(np.round(xyz / 4.0) * 4.0, settings=one_view)
    assert middling.interval_mm[0] < DIAMETER < middling.interval_mm[1]
    assert any("multiples of 4 mm" in warning for warning in middling.warnings)
    # Which of its rows the search takes for a cylinder turns on the last bits of equal scores; the reason is one all the same.
    with pytest.raises(MeasureError, match=r"multiples of 20 mm|No cable found"):
        measure_cable(np.round(xyz / 20.0) * 20.0, settings=one_view)


def test_the_sentences_name_step_and_diameter():
    assert too_coarse(12.0, DIAMETER) is None
    assert str(too_coarse(13.0, DIAMETER)).startswith(
        "The diameter cannot be told: the coordinates are multiples of 13 mm"
    )
    assert (len(about_steps(2.4, DIAMETER)), len(about_steps(2.6, DIAMETER))) == (0, 1)
