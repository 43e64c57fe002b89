"""What the page draws: which points, whose they are, and the section at a place."""

import numpy as np
import pytest

from cablejax.app.section import DRAWN, section
from cablejax.app.view import cable_view, chosen, labels, write_cloud, write_surfaces
from cablejax.measure import measure_cable
from tests.reference.circles import bent_cable


@pytest.fixture(scope="module")
def scan():
    """A cable and a floor that lies far below it."""
    floor = np.random.default_rng(5).uniform([-200, -200, -80], [200, 200, -79], (3000, 3))
    return np.concatenate([bent_cable(n=6000, arc_deg=200), floor])


@pytest.fixture(scope="module")
def cable(scan):
    return measure_cable(scan)


@pytest.mark.parametrize(
    ("on", "off", "most", "expected"),
    [
        (10, 20, 100, (10, 20)),
        (1000, 1000, 100, (50, 50)),
        (20, 1000, 100, (20, 80)),
        (1000, 10, 100, (90, 10)),
        (0, 500, 100, (0, 100)),
    ],
)
def test_points_of_cables_have_half_of_the_places_and_what_is_left_over(on, off, most, expected):
    label = np.concatenate([np.zeros(off, int), np.ones(on, int)])
    rows = chosen(label, most=most)
    assert len(set(rows.tolist())) == len(rows)
    assert ((label[rows] == 1).sum(), (label[rows] == 0).sum()) == expected


def test_every_beginning_of_the_points_is_a_fair_sample():
    label = np.repeat([0, 1], [5000, 5000])
    rows = chosen(label, most=4000)
    # 400 of 4000 with a half on cables: standard deviation .024; five of them.
    assert abs((label[rows[:400]] == 1).mean() - 0.5) < 0.12
    assert abs(rows[:400].mean() / 10_000 - 0.5) < 5 * 0.29 / 20


def test_points_belong_to_the_nearest_surface_and_none_to_one_far_off(scan, cable):
    label = labels([cable], len(scan))
    assert (label[:6000] == 1).mean() > 0.99
    assert not label[6000:].any()
    twice = labels([cable, cable], len(scan))
    assert (twice == label).all()  # of two alike the first


def test_the_cloud_can_be_read_back(scan, cable, tmp_path):
    about = write_cloud(tmp_path / "cloud.bin", scan, [cable])
    data, n = (tmp_path / "cloud.bin").read_bytes(), len(scan)
    assert (about["shown"], about["of"], len(data)) == (n, n, 17 * n)
    xyz = np.frombuffer(data, "<f4", 3 * n).reshape(n, 3) + np.array(about["origin"])
    deviation, label = np.frombuffer(data, "<f4", n, 12 * n), np.frombuffer(data, "u1", n, 16 * n)
    # Rows come in another order: sorted by x they are the scan's, to float32 at 500 mm.
    order = np.argsort(scan[:, 0])
    np.testing.assert_allclose(xyz[np.argsort(xyz[:, 0])][:, 0], scan[order, 0], atol=1e-4)
    assert np.isnan(deviation[label == 0]).all()
    assert np.isfinite(deviation[label == 1]).all()
    assert abs(deviation[label == 1]).std() < 2 * cable.noise_mm
    np.testing.assert_allclose([about["low"], about["high"]], [scan.min(axis=0), scan.max(axis=0)])


def test_a_section_holds_the_points_within_it_and_no_other(scan, cable, tmp_path):
    write_surfaces(tmp_path, [cable])
    at, half = cable.length_mm / 3, 5.0
    found = section(tmp_path / "surface-1.npy", at_mm=at, half_mm=half)
    near = (labels([cable], len(scan)) == 1) & (np.abs(cable.along_mm - at) < half)
    assert found["points"] == near.sum() > 20
    np.testing.assert_allclose(np.sort(found["deviation_mm"]), np.sort(cable.deviation_mm[near]), atol=1e-5)
    np.testing.assert_allclose(np.sort(found["angle_deg"]), np.sort(cable.angle_deg[near]), atol=1e-3)
    assert section(tmp_path / "surface-1.npy", at_mm=-1e6, half_mm=half)["points"] == 0


def test_a_section_of_many_points_is_thinned_and_counted_whole(tmp_path):
    rows = np.stack([np.linspace(0, 10, 3 * DRAWN), np.zeros(3 * DRAWN), np.ones(3 * DRAWN)], axis=1)
    np.save(tmp_path / "surface-1.npy", rows.astype(np.float32))
    found = section(tmp_path / "surface-1.npy", at_mm=5.0, half_mm=20.0)
    assert (found["points"], len(found["angle_deg"])) == (3 * DRAWN, DRAWN)


def test_a_cable_for_the_page_is_json_with_its_axis_measured_along_itself(cable):
    import json

    view = json.loads(json.dumps(cable_view(3, cable), allow_nan=False))
    assert view["number"] == 3
    assert view["quantities"][0][:2] == ["diameter", f"{cable.diameter_mm:.3f}"]
    assert len(view["axis_mm"]) == len(view["along_mm"]) <= 400
    np.testing.assert_allclose(view["along_mm"][-1], cable.length_mm, rtol=1e-3)
    np.testing.assert_allclose([view["pieces_mm"][0], view["pieces_mm"][-1]], cable.axis_mm[[0, -1]])
