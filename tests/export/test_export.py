"""Each export opened by the program that it is for."""

import csv
import json
import shutil
import subprocess

import numpy as np
import pytest

from cablejax.cli import main
from cablejax.export import protocol_page, write_axis, write_deviations, write_drawing, write_sections
from cablejax.export.drawing import straight_pieces
from cablejax.io import read_points, write_points
from cablejax.measure import measure_cable
from cablejax.measure.standards import readings, section_sizes
from tests.app.scans import two_cables
from tests.reference.circles import bent_cable

RADIUS, BEND, OFF = 11.0, 500.0, np.array([1000.0, 2000.0, 3000.0])


@pytest.fixture(scope="module")
def scan():
    """A bent cable all round, an oval one, and some points beside it."""
    cable = bent_cable(n=5000, arc_deg=360, radius=RADIUS, oval=0.2, bend_radius=BEND)
    beside = np.random.default_rng(1).uniform(-60, -30, (50, 3))
    return np.concatenate([cable, beside]) + OFF


@pytest.fixture(scope="module")
def measured(scan):
    return measure_cable(scan)


def equal(found, expected, atol=0.0):
    """Numbers that went through float32."""
    np.testing.assert_allclose(np.asarray(found).ravel(), np.asarray(expected, np.float32), rtol=1e-6, atol=atol)


def test_open3d_reads_the_deviations_of_a_ply(tmp_path, scan, measured):
    open3d = pytest.importorskip("cablejax.io").import_open3d()
    write_deviations(tmp_path / "d.ply", measured, scan)
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / "d.ply"))
    np.testing.assert_array_equal(cloud.point.positions.numpy(), scan)
    equal(cloud.point["deviation_mm"].numpy(), measured.deviation_mm)
    equal(cloud.point["along_mm"].numpy(), measured.along_mm)
    np.testing.assert_array_equal(cloud.point["on_cable"].numpy().ravel(), measured.keep)
    kept = np.abs(cloud.point["deviation_mm"].numpy().ravel()[measured.keep])
    assert np.quantile(kept, 0.95) < 5 * measured.noise_mm
    np.testing.assert_array_equal(read_points(tmp_path / "d.ply").xyz_mm, scan)  # as any other scan


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_laspy_reads_the_deviations_of_extra_bytes(tmp_path, scan, measured, ending):
    laspy = pytest.importorskip("laspy")
    write_deviations(tmp_path / f"d.{ending}", measured, scan, unit="m")
    las = laspy.read(tmp_path / f"d.{ending}")
    assert list(las.point_format.extra_dimension_names) == ["deviation_mm", "along_mm", "angle_deg", "on_cable"]
    np.testing.assert_allclose(1000 * las.xyz, scan, atol=6e-4)  # half a step of 1e-6 m, and rounding
    equal(las["deviation_mm"], measured.deviation_mm)
    equal(las["angle_deg"], measured.angle_deg)
    np.testing.assert_array_equal(las["on_cable"], measured.keep)


def test_deviations_want_the_points_that_were_measured(tmp_path, scan, measured):
    with pytest.raises(ValueError, match=r"xyz_mm: expected the 5050 points that were measured, got \[5049, 3\]"):
        write_deviations(tmp_path / "d.ply", measured, scan[1:])
    with pytest.raises(ValueError, match=r"path: expected the ending .ply, .las or .laz, got '.*d.stl'"):
        write_deviations(tmp_path / "d.stl", measured, scan)


def read_table(path):
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def test_axis_and_sections_lie_on_the_circle_that_was_made(tmp_path, measured):
    write_axis(tmp_path / "axis.csv", measured)
    write_sections(tmp_path / "sections.csv", measured)
    for name in ("axis", "sections"):
        table = read_table(tmp_path / f"{name}.csv")
        x, y, z = (table[f"{axis}_mm"] - off for axis, off in zip("xyz", OFF, strict=True))
        np.testing.assert_allclose(np.hypot(x, y + BEND), BEND, atol=0.3)
        np.testing.assert_allclose(z, 0, atol=0.3)
        assert (np.diff(table["along_mm"]) > 0).all()
    axis = read_table(tmp_path / "axis.csv")
    assert axis["along_mm"][-1] == pytest.approx(measured.length_mm, rel=1e-4)
    direction = np.stack([axis[f"direction_{name}"] for name in "xyz"], axis=1)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(direction[:, 2], 0, atol=0.02)
    sections = read_table(tmp_path / "sections.csv")
    assert (sections["low_mm"] < sections["diameter_mm"]).all()
    assert np.median(sections["diameter_mm"]) == pytest.approx(2 * RADIUS, abs=0.1)


def test_ezdxf_finds_no_fault_in_the_drawing_and_a_cylinder_round_the_axis(tmp_path, measured):
    ezdxf = pytest.importorskip("ezdxf")
    write_drawing(tmp_path / "cable.dxf", measured)
    drawing = ezdxf.readfile(tmp_path / "cable.dxf")
    audit = drawing.audit()
    assert (audit.errors, audit.fixes) == ([], [])
    assert drawing.units == ezdxf.units.MM
    (line,) = drawing.query('POLYLINE[layer=="AXIS"]')
    np.testing.assert_allclose(np.array([v.dxf.location for v in line.vertices]), measured.axis_mm)
    tubes = drawing.query('MESH[layer=="CYLINDERS"]')
    assert len(tubes) >= 3  # it bends
    for tube in tubes:
        corners = np.array(tube.vertices) - OFF
        aside = np.hypot(np.hypot(corners[:, 0], corners[:, 1] + BEND) - BEND, corners[:, 2])
        assert np.abs(aside - measured.diameter_mm / 2).max() < 0.5
    (note,) = drawing.query("MTEXT")
    assert f"diameter {measured.diameter_mm:.3f} mm" in note.text


def test_straight_pieces_stay_within_their_tolerance():
    turn = np.linspace(0, np.pi, 400)
    curve = 100 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    pieces = straight_pieces(curve, 0.5)
    # A chord of an arc of a radians leaves it by r (1 - cos(a / 2)).
    assert len(pieces) - 1 >= np.pi / (2 * np.arccos(1 - 0.5 / 100))
    assert len(pieces) < 40
    ends = pieces[1:] - pieces[:-1]
    sagitta = 100 - np.sqrt(100**2 - (np.linalg.norm(ends, axis=1) / 2) ** 2)
    assert sagitta.max() <= 0.5 + 1e-9
    assert len(straight_pieces(np.outer(np.arange(9.0), np.ones(3)), 1e-9)) == 2


@pytest.fixture(scope="module")
def page(measured):
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    free = measured.free_section
    read = readings(measured.diameter_mm, across_mm=free.square_mm, limits_mm=(21.0, 23.0))
    sizes = section_sizes(free.angle_deg, free.radius_mm)
    source = {"file": "<b>.ply"}
    return protocol_page(measured, title="<a> & b", source=source, read=read, sizes=sizes, limits_mm=(21.0, 23.0))


def test_the_protocol_says_what_was_measured_read_and_judged(page, measured):
    for text in (
        f"{measured.diameter_mm:.3f} mm", "22.4 mm and 21.6 mm", "minimum circumscribed (GN)", "verdict on the reading",
        "&lt;a&gt; &amp; b", "&lt;b&gt;.ply", "IEC 60811-203",
    ):  # fmt: skip
        assert text in page
    assert "<script" not in page


def test_chromium_prints_the_protocol(page, tmp_path):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium")
    (tmp_path / "p.html").write_text(page, encoding="utf-8")
    target = tmp_path / "p.pdf"
    flags = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    subprocess.run(
        [browser, *flags, f"--print-to-pdf={target}", f"file://{tmp_path / 'p.html'}"], capture_output=True, timeout=120
    )
    content = target.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= content.count(b"/Type /Page\n") <= 5


def test_the_command_writes_every_format(tmp_path, scan, capsys):
    pytest.importorskip("ezdxf")
    write_points(tmp_path / "scan.ply", scan)
    target = tmp_path / "out"
    arguments = ["measure", str(tmp_path / "scan.ply"), "--unit", "mm", "--quiet", "--export", str(target), "--formats"]
    assert main([*arguments, "ply", "laz", "csv", "dxf", "html"]) == 0
    names = ["axis.csv", "cable.dxf", "deviations.laz", "deviations.ply", "protocol.html", "sections.csv"]
    assert sorted(path.name for path in target.iterdir()) == names
    assert "reading (IEC 60811-203)" in capsys.readouterr().out
    (tmp_path / "file").write_text("")
    assert main([*arguments[:-2], str(tmp_path / "file"), "--formats", "ply"]) == 1
    assert "cannot be a folder for results" in capsys.readouterr().err


def test_a_folder_of_scans_exports_a_folder_each(tmp_path, scan, capsys):
    (tmp_path / "scans").mkdir()
    for name in ("a.ply", "b.ply"):
        write_points(tmp_path / "scans" / name, scan)
    arguments = ["measure", str(tmp_path / "scans"), "--unit", "mm", "--jobs", "0", "--export", str(tmp_path / "out")]
    arguments += ["--formats", "csv", "--csv", str(tmp_path / "t.csv")]
    assert main(arguments) == 0
    assert sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.csv")) == [
        "a.ply/axis.csv", "a.ply/sections.csv", "b.ply/axis.csv", "b.ply/sections.csv",
    ]  # fmt: skip
    shutil.rmtree(tmp_path / "out" / "b.ply")
    capsys.readouterr()
    assert main(arguments) == 0
    assert "1 of 1" in capsys.readouterr().err
    assert (tmp_path / "out" / "b.ply" / "axis.csv").exists()


@pytest.mark.parametrize("kind", ["scan", "folder"])
def test_every_cable_of_a_scene_has_its_own_exports(tmp_path, capsys, kind):
    (tmp_path / "scans").mkdir()
    write_points(tmp_path / "scans" / "two.ply", two_cables(1500))
    source = tmp_path / "scans" if kind == "folder" else tmp_path / "scans" / "two.ply"
    arguments = [
        "measure",
        str(source),
        "--unit",
        "mm",
        "--all",
        "--export",
        str(tmp_path / "out"),
        "--quiet",
        "--json",
    ]
    arguments += ["--formats", "ply", "csv", "dxf", "html", *(["--jobs", "0"] if kind == "folder" else [])]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    out = tmp_path / "out" / "two.ply" if kind == "folder" else tmp_path / "out"
    diameters = [one["diameter_mm"] for one in result["rows" if kind == "folder" else "cables"]]
    assert len(diameters) == 2
    for number, diameter in enumerate(diameters, 1):
        folder = out / f"cable-{number}"
        assert {path.name for path in folder.iterdir()} == {
            "deviations.ply",
            "axis.csv",
            "sections.csv",
            "cable.dxf",
            "protocol.html",
        }
        page = (folder / "protocol.html").read_text()
        assert f"two.ply, cable {number}" in page
        assert f"{diameter:.3f} mm" in page
    if kind == "scan":
        assert len(result["exported"]) == 10
