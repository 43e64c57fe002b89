"""What earns a cylinder its place: an end where the arc ends, a curve rather than faces, errors that neighbours do not share."""

import numpy as np
import pytest

from benchmarks.real import summary, verdict
from cablejax.measure import MeasureError, MeasureSettings, measure_cable
from cablejax.measure.fit.axis import sampled
from cablejax.measure.fit.least_squares import CableFit, fit_cable
from cablejax.measure.shape.ends import extent, joined
from cablejax.measure.shape.faces import flat_faces
from cablejax.measure.shape.sections import BIN_DEG, arc_of, bins_of
from cablejax.measure.uncertainty.shared_errors import UNSEEN, shared_mm

RADIUS, LENGTH = 15.0, 120.0


def fitted(xyz: np.ndarray) -> CableFit:
    return fit_cable(xyz, sampled(np.array([[0.0, 0, 0], [LENGTH, 0, 0]]), step=3.0), RADIUS, knot_diameters=np.inf)


def cylinder(arc_deg: float, *, noise: float = 0.1, n: int = 4000, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    angle = np.radians(rng.uniform(-arc_deg / 2, arc_deg / 2, n))
    radius = RADIUS + noise * rng.normal(size=n)
    return np.stack([rng.uniform(0, LENGTH, n), radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def ridge(fold_deg: float, *, noise: float = 0.1, n: int = 4000) -> np.ndarray:
    """Two flat faces that meet along a line, about as far from the axis as the surface of the cylinder."""
    rng = np.random.default_rng(1)
    along, side = rng.uniform(0, LENGTH, n), rng.uniform(-14, 14, n)
    slope = np.tan(np.radians(fold_deg / 2))
    return np.stack([along, RADIUS + 2 - slope * np.abs(side) + noise * rng.normal(size=n), side], axis=1)


@pytest.mark.parametrize("arc_deg", [60.0, 120.0, 180.0, 360.0])
def test_a_cylinder_is_no_box(arc_deg):
    assert flat_faces(fitted(cylinder(arc_deg)), arc_deg) is None


@pytest.mark.parametrize("fold_deg", [60.0, 90.0])
def test_the_edge_of_a_box_is_two_faces(fold_deg):
    fit = fitted(ridge(fold_deg))
    assert flat_faces(fit, arc_of(np.arctan2(fit.place.v, fit.place.u))) == 2


def test_a_square_bar_is_four_faces():
    rng = np.random.default_rng(2)
    side, across = rng.integers(4, size=6000), rng.uniform(-13, 13, 6000)
    turn = 0.5 * np.pi * side
    y, z = 13 * np.cos(turn) - across * np.sin(turn), 13 * np.sin(turn) + across * np.cos(turn)
    xyz = np.stack([rng.uniform(0, LENGTH, 6000), y, z], axis=1) + 0.1 * rng.normal(size=(6000, 3))
    assert flat_faces(fitted(xyz), 360.0) == 4


@pytest.mark.parametrize("arc_deg", [240.0, 320.0])
def test_what_tapers_is_brought_to_one_size_first(arc_deg):
    """A stem that tapers to half its width: about its mean radius it scatters as a triangle does."""
    xyz = cylinder(arc_deg, noise=0.5, n=8000)
    xyz[:, 1:] *= 1.35 - 0.7 * xyz[:, :1] / LENGTH
    assert flat_faces(fitted(xyz), arc_deg) is None
    rng = np.random.default_rng(3)
    side, across = rng.integers(4, size=8000), rng.uniform(-13, 13, 8000)
    turn = 0.5 * np.pi * side
    y, z = 13 * np.cos(turn) - across * np.sin(turn), 13 * np.sin(turn) + across * np.cos(turn)
    along = rng.uniform(0, LENGTH, 8000)
    bar = np.stack([along, y, z], axis=1)
    bar[:, 1:] *= 1.2 - 0.4 * along[:, None] / LENGTH
    assert flat_faces(fitted(bar), 360.0) == 4


def test_noise_is_not_shared_and_a_pattern_is():
    plain, xyz = cylinder(120.0), cylinder(120.0)
    # Chance correlations are taken off at two standard deviations of theirs: what is left is below a quarter of the noise.
    assert shared_mm(fitted(plain), None)[0] < 0.025
    wave = 0.3 * np.sin(2 * np.pi * xyz[:, 0] / 20)
    direction = xyz * [0, 1, 1] / np.linalg.norm(xyz[:, 1:], axis=1, keepdims=True)
    shared, left_open = shared_mm(fitted(xyz + wave[:, None] * direction), None)
    assert shared == pytest.approx(0.3 / np.sqrt(2), rel=0.1)
    assert left_open > UNSEEN * shared  # over 120 degrees a radius shows less than itself


def test_what_one_sweep_shares_is_left_to_the_fit():
    xyz = cylinder(120.0)
    sweep = np.random.default_rng(3).integers(2, size=len(xyz))
    moved = xyz + np.where(sweep == 0, 0.3, -0.3)[:, None] * [0.0, 1.0, 0.0]
    fit = fitted(moved)
    assert shared_mm(fit, sweep)[0] < 0.05
    assert shared_mm(fit, np.zeros_like(sweep))[0] == 0.0  # a single sweep has no neighbours of another


def test_short_arcs_leave_more_open():
    shares = []
    for arc in (360.0, 90.0):
        xyz = cylinder(arc)
        outward = xyz * [0, 1, 1] / np.linalg.norm(xyz[:, 1:], axis=1, keepdims=True)
        shared, left_open = shared_mm(fitted(xyz + 0.3 * np.sin(0.3 * xyz[:, :1]) * outward), None)
        shares.append(left_open / shared / UNSEEN)
    # 1 over the whole circumference; over 90 degrees the constant less its projection on the cosine leaves 0.097.
    np.testing.assert_allclose(shares, [1.0, 10.28], rtol=0.06)


def test_another_side_of_each_stretch_is_no_large_arc():
    # Each stretch of a diameter shows 60 degrees, all of them together 250: no section tells a radius by itself.
    rng = np.random.default_rng(5)
    along = rng.uniform(0, LENGTH, 20_000)
    angle = np.radians(rng.uniform(-30, 30, 20_000) + 190 * np.floor(along / (2 * RADIUS)) / (LENGTH / (2 * RADIUS)))
    outward = np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    rough = RADIUS + 0.1 * rng.normal(size=20_000) + 0.3 * np.sin(0.3 * along)
    shared, left_open = shared_mm(fitted(along[:, None] * [1.0, 0.0, 0.0] + rough[:, None] * outward), None)
    # 60 degrees leave 23.7 times as much open, 250 degrees 1.4 times; stretches of the fit lie across two of these.
    assert left_open > 8 * UNSEEN * shared


def test_a_stub_at_the_end_does_not_count_for_a_stretch():
    # 1.2 diameters of 120 degrees, of which the last fifth shows 20.
    rng = np.random.default_rng(6)
    along, angle = rng.uniform(0, 36, 12_000), np.radians(rng.uniform(-60, 60, 12_000))
    kept = (along < 30) | (np.abs(angle) < np.radians(10))
    along, angle = along[kept], angle[kept]
    rough = RADIUS + 0.1 * rng.normal(size=len(along)) + 0.3 * np.sin(0.5 * along)
    xyz = np.stack([along, rough * np.cos(angle), rough * np.sin(angle)], axis=1)
    shared, left_open = shared_mm(fitted(xyz), None)
    assert left_open < 7 * UNSEEN * shared  # 5.5 times over 120 degrees, hundreds of times over 20


@pytest.mark.parametrize("arc", [40.0, 60.0, 75.0])
def test_errors_that_a_short_arc_shares_are_refused_or_in_the_interval(arc):
    rng = np.random.default_rng(0)
    along, angle = rng.uniform(0, LENGTH, 9000), np.radians(rng.uniform(-arc / 2, arc / 2, 9000))
    wave = 0.04 * np.sin(2 * np.pi * along / 25) * np.cos(2 * np.pi * np.degrees(angle) / 40)
    radius = RADIUS + wave + 0.01 * rng.normal(size=9000)
    xyz = np.stack([along, radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    if arc == 40.0:  # a thirtieth of the radius is left open; over 60 degrees an eightieth, which the interval holds
        with pytest.raises(MeasureError, match=r"share errors of 0\.0"):
            measure_cable(xyz, settings=MeasureSettings(stations=1))
        return
    low, high = measure_cable(xyz, settings=MeasureSettings(stations=1)).interval_mm
    assert low < 2 * RADIUS < high


def test_the_thing_ends_where_its_arc_does():
    rng = np.random.default_rng(4)
    along = np.concatenate([rng.uniform(0, 100, 6000), rng.uniform(100, 200, 800)])
    angle = np.radians(np.concatenate([rng.uniform(0, 150, 6000), rng.uniform(0, 40, 800)]))
    low, high = extent(along, angle, radius_mm=RADIUS)
    assert low == pytest.approx(0, abs=1)
    assert high == pytest.approx(100, abs=0.5 * RADIUS)  # one slab


@pytest.mark.parametrize("seed", range(5))
def test_a_thin_stretch_is_no_end_and_a_dense_gap_is(seed):
    """Gaps around the circumference count as chance where points are few, and as gaps where they are many."""
    rng = np.random.default_rng(seed)
    dense, thin = (np.stack([rng.uniform(0, 100, n), rng.uniform(0, 2 * np.pi, n)]) for n in (6000, 500))
    beyond = np.array([[100.0], [0.0]])
    along, angle = np.concatenate([dense, thin + beyond], axis=1)
    assert extent(along, angle, radius_mm=RADIUS)[1] > 190
    open_ = np.degrees(dense[1]) % 60 < 32  # strips with 28 degrees between them: half of the circumference
    along, angle = np.concatenate([dense, dense[:, open_] + beyond], axis=1)
    assert extent(along, angle, radius_mm=RADIUS)[1] == pytest.approx(100, abs=0.5 * RADIUS)


def test_a_tie_does_not_end_a_cable_and_a_far_stub_is_no_part_of_it():
    shown = np.array([1] * 10 + [0] * 2 + [1] * 10 + [0] * 5 + [1] * 2, dtype=bool)
    assert joined(shown, np.ones(len(shown))) == (0, 21)
    assert joined(shown[::-1], np.ones(len(shown))) == (7, 28)


def test_an_angle_that_rounds_to_a_whole_turn_has_a_bin():
    angle = np.array([-1e-17, 0.0, 2 * np.pi, np.pi])
    assert bins_of(angle).max() < 360 / BIN_DEG
    assert arc_of(angle) == 2 * BIN_DEG


def test_an_axis_that_runs_away_is_stopped():
    rng = np.random.default_rng(6)
    clutter = rng.uniform(-1, 1, size=(3000, 3)) * [LENGTH, 200.0, 200.0]
    line = sampled(np.array([[-LENGTH, 0.0, 0.0], [LENGTH, 0.0, 0.0]]), step=0.6)
    with pytest.raises(MeasureError, match=r"No cable found|Too few points on the cable"):
        fit_cable(clutter, line, 3.0)


@pytest.mark.parametrize(
    ("truth", "row", "expected"),
    [
        ("6.0", {"interval_mm": [5.0, 7.0]}, "holds"),
        ("34.4 or 37.0", {"interval_mm": [36.5, 38.0]}, "holds"),
        ("6.0", {"interval_mm": [6.5, 7.0]}, "misses"),
        ("6.0", {"refused": "why"}, "refused"),
        ("no cable", {"refused": "why"}, "rightly refused"),
        ("no cable", {"interval_mm": [5.0, 7.0]}, "false cable"),
        ("", {"interval_mm": [5.0, 7.0]}, "measured"),
        ("6.0", {"failed": "why"}, "failed"),
    ],
)
def test_verdicts_on_real_scans(truth, row, expected):
    assert verdict(truth, row) == expected


def test_summary_counts_by_grade():
    rows = [
        {"grade": "A", "verdict": "holds"},
        {"grade": "B", "verdict": "misses"},
        {"grade": "", "verdict": "measured"},
    ]
    table = {line["grade"]: line for line in summary(rows)}
    assert table["A"]["holds"] == 1
    assert table["no truth"]["measured"] == 1
    assert table["A, B, C"]["share_held"] == 0.5
