"""Readings after IEC 60811-203 and sizes after ISO 14405-1, against shapes whose sizes can be written down."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from cablejax.measure.standards import readings, section_sizes

ANGLE = np.arange(180) * 2.0
TURN = np.radians(ANGLE)


def moved(radius, x, y):
    """The same closed curve seen from another point: radius in the same directions, by bisection."""
    shape = lambda angle: np.interp(angle, TURN, radius, period=2 * np.pi)  # noqa: E731
    out = np.empty_like(radius)
    for i, angle in enumerate(TURN):
        low, high = 0.0, 3 * radius.max()
        for _ in range(80):
            middle = (low + high) / 2
            px, py = middle * np.cos(angle) + x, middle * np.sin(angle) + y
            inside = np.hypot(px, py) < shape(np.arctan2(py, px) % (2 * np.pi))
            low, high = (middle, high) if inside else (low, middle)
        out[i] = middle
    return out


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.6, -0.4)])
@pytest.mark.parametrize(
    ("lobes", "amplitude", "two_point"),
    [(0, 0.0, (30, 30)), (2, 0.5, (29, 31)), (3, 0.3, (30, 30)), (4, 0.2, (29.6, 30.4))],
)
def test_lobed_sections(lobes, amplitude, two_point, offset):
    radius = 15 + amplitude * np.cos(lobes * TURN)
    sizes = section_sizes(ANGLE, radius if offset == (0.0, 0.0) else moved(radius, *offset))
    # Extremes may lie between two of the 180 points, a degree from either; the moved curve is interpolated, twice as far.
    close = 2 * amplitude * lobes**2 * np.radians(1 if offset == (0.0, 0.0) else 2) ** 2 / 2 + 1e-6
    assert sizes.maximum_inscribed_mm == pytest.approx(2 * (15 - amplitude), abs=close)
    assert sizes.minimum_circumscribed_mm == pytest.approx(2 * (15 + amplitude), abs=close)
    assert sizes.minimum_zone_mm == pytest.approx(30, abs=close)
    assert sizes.roundness_mm == pytest.approx(2 * amplitude, abs=close)
    assert sizes.least_squares_mm == pytest.approx(30, abs=close)
    assert (sizes.two_point_minimum_mm, sizes.two_point_maximum_mm) == pytest.approx(two_point, abs=close)


def test_random_profiles_against_searches_of_another_kind():
    rng = np.random.default_rng(0)
    for _ in range(3):
        waves = sum(rng.normal(0, 0.2) * np.cos(k * TURN + rng.uniform(0, 6)) for k in range(1, 6))
        points = (10 + waves)[:, None] * np.stack([np.cos(TURN), np.sin(TURN)], axis=1)
        sizes = section_sizes(ANGLE, 10 + waves)
        assert sizes.roundness_mm == pytest.approx(least(lambda c, p: np.ptp(away(p, c)), points), abs=1e-7)
        assert sizes.maximum_inscribed_mm == pytest.approx(-2 * least(lambda c, p: -away(p, c).min(), points), abs=1e-7)
        assert sizes.minimum_circumscribed_mm == pytest.approx(
            2 * least(lambda c, p: away(p, c).max(), points), abs=1e-7
        )
        gaussian = least_squares(residual, [0, 0, 10.0], args=(points,), xtol=1e-14, ftol=1e-14)
        assert sizes.least_squares_mm == pytest.approx(2 * gaussian.x[2], abs=1e-7)


def away(points, centre):
    return np.linalg.norm(points - centre, axis=1)


def residual(p, points):
    return away(points, p[:2]) - p[2]


def least(cost, points):
    """The least cost over centres, which near the middle has no other valley: by thirds in y for each third in x."""

    def thirds(along, low=-2.0, high=2.0):
        while high - low > 1e-9:
            a, b = low + (high - low) / 3, high - (high - low) / 3
            low, high = (low, b) if along(a) < along(b) else (a, high)
        return along((low + high) / 2)

    return thirds(lambda x: thirds(lambda y: cost(np.array([x, y]), points)))


def test_readings_below_and_above_25_mm():
    found = readings(21.24, across_mm=(21.46, 21.02), limits_mm=(21.3, 22.0))
    assert (found.method, found.readings_mm, found.mean_mm, found.verdict) == (
        "two perpendicular",
        (21.5, 21.0),
        21.3,
        "pass",
    )
    found = readings(24.98)
    assert (found.method, found.readings_mm, found.step_mm, found.verdict) == ("one diameter", (25.0,), 0.1, None)
    found = readings(34.26, across_mm=(34.4, 34.1), limits_mm=(33.0, 34.0))
    assert (found.method, found.readings_mm, found.verdict) == ("circumference", (34.5,), "fail")


def test_halves_are_rounded_up_though_binary_has_them_a_hair_below():
    assert [readings(d).mean_mm for d in (10.05, 10.15, 10.25, 10.35, 10.449)] == [10.1, 10.2, 10.3, 10.4, 10.4]
    assert [readings(d).mean_mm for d in (30.25, 30.75, 30.74)] == [30.5, 31.0, 30.5]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: readings(-1.0), "diameter_mm, across_mm: expected positive numbers"),
        (lambda: readings(20.0, across_mm=(20.0, float("nan"))), "expected positive numbers"),
        (lambda: readings(20.0, limits_mm=(2.0, 1.0)), "limits_mm: expected the lower one first"),
        (lambda: section_sizes(ANGLE[:-1], np.ones(179)), "angle_deg: expected an even number of even steps"),
        (lambda: section_sizes(ANGLE, np.zeros(180)), "radius_mm: expected positive numbers"),
    ],
)
def test_what_cannot_be_read_is_named(call, text):
    with pytest.raises(ValueError, match=text):
        call()
