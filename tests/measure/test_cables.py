"""Every cable of a scene: none missed, none made up, each with its number; and what limits leave of them."""

import numpy as np
import pytest

from cablejax.cli import main
from cablejax.io import write_points
from cablejax.measure import MeasureError, MeasureSettings, SearchLimits, measure_cable, measure_cables
from cablejax.measure.find.planes import Plane, corrugated

LENGTH = 240.0


def cylinder(radius: float, center=(0.0, 0.0), *, turn_deg=0.0, arc_deg=360.0, toward_deg=90.0, n=3500, seed=0):
    """Points of a cylinder along x, or turned about z, its arc about a direction in the y-z plane, noise of .05 mm."""
    rng = np.random.default_rng(seed)
    angle = np.radians(toward_deg + rng.uniform(-arc_deg / 2, arc_deg / 2, n))
    r = radius + 0.05 * rng.normal(size=n)
    x, y, z = rng.uniform(-LENGTH / 2, LENGTH / 2, n), r * np.cos(angle), r * np.sin(angle)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return np.stack([c * x - s * y, s * x + c * y + center[0], z + center[1]], axis=1)


def holds(measured, diameter: float) -> bool:
    # Three standard deviations: one interval of twenty misses its truth by chance, one of four hundred so.
    return abs(measured.diameter_mm - diameter) < 3 * measured.std_mm


@pytest.fixture(scope="module")
def shelf():
    """Two that touch and one apart, of different sizes, seen from above over half of each."""
    parts = [(10.0, -60.0), (8.0, 0.0), (12.0, 20.0)]
    return np.concatenate(
        [cylinder(r, (y, r), arc_deg=180.0, seed=i) for i, (r, y) in enumerate(parts)]
        + [np.random.default_rng(9).uniform([-120, -80, -0.1], [120, 60, 0.1], (4000, 3))]
    )


@pytest.fixture(scope="module")
def found(shelf):
    return measure_cables(shelf, expect=3)


def test_all_are_found_in_their_order(found):
    assert found.warnings == ()
    assert found.not_measured == ()
    assert len(found.cables) == 3
    assert all(holds(one, d) for one, d in zip(found.cables, (20.0, 16.0, 24.0), strict=True))


def test_each_point_has_its_cables_number(shelf, found):
    label = found.label
    for number, rows in enumerate((slice(0, 3500), slice(3500, 7000), slice(7000, 10_500)), 1):
        assert (label[rows] == number).mean() > 0.97
    # Where a cable lies on the floor, a stripe of the floor is within .08 R: 2 sqrt(2 * .08) R of 140 mm, so .17 of it.
    assert 0.1 < (label[10_500:] > 0).mean() < 0.22
    assert [one["number"] for one in found.to_dict()["cables"]] == [1, 2, 3]


@pytest.mark.parametrize(
    ("limits", "diameter"),
    [
        (SearchLimits(diameter_mm=(14.0, 18.0)), 16.0),
        (SearchLimits(near_mm=(0.0, -60.0, 25.0)), 20.0),
        (SearchLimits(box_mm=((130.0, 5.0, 0.5), (-130.0, 40.0, 40.0))), 24.0),
    ],
)
def test_one_cable_by_what_is_known_of_it(shelf, limits, diameter):
    assert holds(measure_cable(shelf, settings=MeasureSettings(limits=limits)), diameter)


def test_crossing_cables_and_the_direction_that_is_sought():
    crossed = np.concatenate([cylinder(10.0), cylinder(10.0, (0.0, 20.0), turn_deg=70.0, seed=1)])
    scene = measure_cables(crossed)
    assert len(scene.cables) == 2
    assert all(holds(one, 20.0) for one in scene.cables)
    turned = (np.cos(np.radians(70.0)), np.sin(np.radians(70.0)), 0.0)
    along = measure_cables(crossed, settings=MeasureSettings(limits=SearchLimits(axis=turned)), expect=2)
    (only,) = along.cables
    way = only.axis_mm[-1] - only.axis_mm[0]
    assert abs(way @ turned) / np.linalg.norm(way) > 0.99
    assert along.warnings == ("1 cable was measured where 2 were expected.",)


def test_a_trefoil_is_three_cables():
    center = 10 / np.cos(np.pi / 6) * np.array([[np.cos(a), np.sin(a)] for a in np.radians([90.0, 210.0, 330.0])])
    away = [90.0, 210.0, 330.0]
    scan = np.concatenate(
        [
            cylinder(10.0, tuple(c), arc_deg=260.0, toward_deg=t, seed=i)
            for i, (c, t) in enumerate(zip(center, away, strict=True))
        ]
    )
    scene = measure_cables(scan, expect=3)
    assert len(scene.cables) == 3
    assert all(holds(one, 20.0) for one in scene.cables)


def test_limits_that_nothing_meets_are_named(shelf):
    with pytest.raises(MeasureError, match="No cable found with diameters of 100 to 110 mm"):
        measure_cable(shelf, settings=MeasureSettings(limits=SearchLimits(diameter_mm=(100.0, 110.0))))
    limits = SearchLimits(box_mm=((500.0, 0.0, 0.0), (600.0, 1.0, 1.0)))
    with pytest.raises(MeasureError, match="of 14,500 points 0 lie in the box"):
        measure_cables(shelf, settings=MeasureSettings(limits=limits))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"diameter_mm": (30.0, 20.0)}, r"diameter_mm: expected 0 <= low < high, got 30 20"),
        ({"axis": (0.0, 0.0, 0.0)}, "axis: expected a direction"),
        ({"near_mm": (0.0, np.nan, 0.0)}, "near_mm: expected finite"),
        ({"box_mm": ((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))}, "box_mm: expected two corners"),
    ],
)
def test_limits_are_checked(wrong, message):
    with pytest.raises(ValueError, match=message):
        SearchLimits(**wrong)


def test_a_row_of_crests_is_no_plane_and_a_rough_floor_is_one():
    rng = np.random.default_rng(3)
    row = np.concatenate([cylinder(10.0, (20.0 * i, 0.0), arc_deg=150.0, seed=i) for i in range(6)])
    plane = Plane(row.mean(axis=0), np.array([0.0, 0.0, 1.0]), 40.0, 70.0, 6.0)
    assert corrugated(plane, row)
    floor = rng.uniform([-100, -100, 0], [100, 100, 0], (6000, 3)) + [0.0, 0.0, 1.0] * rng.normal(size=(6000, 1))
    assert not corrugated(Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), 40.0, 70.0, 3.0), floor)


def test_the_command_numbers_them_in_every_output(shelf, tmp_path, capsys):
    write_points(tmp_path / "scan.ply", shelf, unit="mm")
    files = [str(tmp_path / name) for name in ("all.csv", "all.png", "all.html")]
    outputs = ["--csv", files[0], "--picture", files[1], "--report", files[2]]
    assert main(["measure", str(tmp_path / "scan.ply"), "--unit", "mm", "--all", "--expect", "4", *outputs]) == 0
    told = capsys.readouterr().out
    assert "cable 3" in told
    assert "3 cables were measured where 4 were expected" in told
    rows = (tmp_path / "all.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows] == ["number", "1", "2", "3"]
    assert (tmp_path / "all.png").read_bytes()[:4] == b"\x89PNG"
    assert "Cable 3" in (tmp_path / "all.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--expect", "2"], "--expect: is for --all"),
        (["--diameter", "30", "20"], "--diameter: expected 0 <= low < high"),
        (["--stations", "0"], "--stations: expected at least 1"),
        (["--all", "--expect", "0"], "--expect: expected at least 1"),
    ],
)
def test_the_command_refuses_what_it_cannot_do(arguments, message, tmp_path, capsys):
    write_points(tmp_path / "scan.ply", np.eye(3), unit="mm")
    assert main(["measure", str(tmp_path / "scan.ply"), "--unit", "mm", *arguments]) == 1
    assert message in capsys.readouterr().err


def test_a_rough_cable_of_a_scene_must_be_measured_again():
    # One search of these 500 points in no order at all saw a cable of 66 +- 7 mm, which `measure_cable` refuses.
    noise = np.random.default_rng(2).uniform(-50, 50, (500, 3))
    with pytest.raises(MeasureError, match="No cable found"):
        measure_cables(noise)
