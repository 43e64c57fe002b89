"""The command: tables, JSON, exit codes, and one clear line for everything a user can get wrong."""

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.cli import main
from cablejax.cli.schema import read_schema
from cablejax.io import read_points, write_points
from tests.reference.circles import bent_cable

HEAVY = ("open3d", "hydra", "matplotlib", "plotly", "flax", "optax")


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("scans") / "cable.ply"
    write_points(path, bent_cable(n=4000))
    return str(path)


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    code = main(arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_measure_prints_a_table_with_the_interval(capsys, scan):
    code, out, err = run(capsys, "measure", scan, "--unit", "mm")
    assert code == 0
    assert "diameter" in out
    assert "(95 %: 29." in out
    assert "uncertainty of the diameter" in out
    assert "measuring 4,000 points" in err


def test_measure_as_json_is_one_object_and_nothing_else(capsys, scan):
    code, out, err = run(capsys, "measure", scan, "--unit", "mm", "--json", "--quiet", "--catalogue", "8.7/15")
    assert code == 0
    assert err == ""
    result = json.loads(out)
    assert result["diameter_mm"] == pytest.approx(30, abs=0.05)
    assert result["interval_mm"][0] < 30 < result["interval_mm"][1]
    assert sum(result["nominal"].values()) == pytest.approx(1)


def test_measure_writes_a_report(capsys, scan, tmp_path):
    report = tmp_path / "new" / "report.html"
    code, _, _ = run(capsys, "measure", scan, "--unit", "mm", "--report", str(report))
    assert code == 0
    assert "<html" in report.read_text(encoding="utf-8")


def test_the_unit_is_taken_with_a_warning(capsys, scan):
    _, _, err = run(capsys, "info", scan)
    assert "warning: no --unit given" in err


def test_what_is_not_one_diameter_is_told_stretch_by_stretch(capsys, tmp_path):
    wider = bent_cable(radius=16.2, length=150.0, seed=1) + np.array([150.0, 0, 0])
    write_points(tmp_path / "stepped.ply", np.concatenate([bent_cable(length=150.0), wider]))
    report = tmp_path / "stepped.html"
    code, out, _ = run(capsys, "measure", str(tmp_path / "stepped.ply"), "--unit", "mm", "--report", str(report))
    assert code == 0
    assert re.search(r"step (up|down) +at 1[45]\d mm, [+-]2\.[34]\d mm", out)
    assert len(re.findall(r"^ +-?\d+ to \d+ mm +(?:29\.9|30\.0|32\.3|32\.4)\d mm", out, re.MULTILINE)) == 2
    assert "Stretch" in report.read_text(encoding="utf-8")


def test_info(capsys, scan):
    code, out, _ = run(capsys, "info", scan, "--unit", "m", "--json")
    result = json.loads(out)
    assert code == 0
    assert result["points"] == 4000
    assert result["maximum_mm"][0] == pytest.approx(400_000, rel=0.01)


def test_denoise_removes_outliers_and_keeps_the_rest_near(capsys, tmp_path):
    source, target = tmp_path / "in.xyz", tmp_path / "out.ply"
    xyz = np.vstack([bent_cable(n=1500), [[200.0, 0, 60], [100, 50, 50]]])
    write_points(source, xyz)
    code, out, _ = run(capsys, "denoise", str(source), str(target), "--unit", "mm", "--neighbors", "30", "--json")
    result = json.loads(out)
    cleaned = read_points(target).xyz_mm
    assert code == 0
    assert len(cleaned) == 1502 - result["removed"]
    assert cleaned[:, 2].max() < 20
    assert 0 < result["moved_rms_mm"] < 0.5


ODD = {
    "rounded to a grid": np.round(bent_cable(n=1500)),
    "each 25 times": np.repeat(bent_cable(n=60), 25, axis=0),
    "a line": np.outer(np.linspace(0, 100, 1500), [1.0, 0.0, 0.0]),
    "at one place": np.full((1500, 3), 7.0),
}


@pytest.mark.parametrize("name", ODD)
def test_denoise_writes_clouds_whose_neighbours_determine_no_surface(capsys, tmp_path, name):
    source, target = tmp_path / "in.xyz", tmp_path / "out.ply"
    write_points(source, ODD[name])
    code, out, _ = run(capsys, "denoise", str(source), str(target), "--unit", "mm", "--neighbors", "30", "--json")
    assert code == 0
    cleaned, result = read_points(target).xyz_mm, json.loads(out)
    assert len(cleaned) == 1500 - result["removed"] > 1000
    nearest = cKDTree(ODD[name]).query(cleaned)[0]
    assert nearest.max() < 2.0  # nothing is thrown about


def test_denoise_in_tiles_writes_the_same(capsys, tmp_path):
    source = tmp_path / "in.las"
    write_points(source, bent_cable(n=3000))
    written = []
    for name, extra in (("whole.las", ()), ("tiled.las", ("--tile", "2048"))):
        target = tmp_path / name
        arguments = ("denoise", str(source), str(target), "--unit", "mm", "--neighbors", "12", "--order", "0", *extra)
        code, out, _ = run(capsys, *arguments)
        assert code == 0
        written.append(read_points(target).xyz_mm)
    assert "tiles" in out
    np.testing.assert_allclose(written[1], written[0], atol=2e-3)  # LAS holds steps of 1 um, tiles of 1e-3 mm
    code, _, err = run(
        capsys, "denoise", str(source), str(tmp_path / "a.las"), "--unit", "mm", "--tile", "5", "--quiet"
    )
    assert code == 1
    assert "tile_points: expected at least" in err


def test_simulate_then_measure(capsys, tmp_path):
    path = tmp_path / "simulated.ply"
    code, out, _ = run(capsys, "simulate", str(path), "--points", "6000", "--arc", "360", "--preset", "ideal", "--json")
    truth = json.loads(out)["true_diameter_mm"]
    assert code == 0
    _, out, _ = run(capsys, "measure", str(path), "--unit", "mm", "--json")
    assert json.loads(out)["diameter_mm"] == pytest.approx(truth, abs=1e-3)


def test_register_writes_the_moved_scan(capsys, scan, tmp_path):
    moved, back = tmp_path / "moved.ply", tmp_path / "back.ply"
    write_points(moved, bent_cable(n=4000, seed=3) + np.array([0.0, 0.4, -0.3]))
    code, out, _ = run(
        capsys, "register", str(moved), scan, "--unit", "mm", "--output", str(back), "--max-distance", "5"
    )
    assert code == 0
    assert "2 of 6 directions of motion" in out
    assert np.abs(np.hypot(*read_points(back).xyz_mm[:, 1:].T) - 15).mean() < 0.15


def test_register_brings_several_files_into_the_frame_of_the_last(capsys, tmp_path):
    wanted, names = np.array([[0.0, 0.3, -0.2], [0.0, -0.2, 0.1], [0.0, 0.0, 0.0]]), []
    for number, shift in enumerate(wanted):
        names.append(str(tmp_path / f"{number}.ply"))
        write_points(names[-1], bent_cable(n=4000, seed=number, arc_deg=200.0) - shift)
    output = tmp_path / "all.ply"
    arguments = ("register", *names, "--unit", "mm", "--voxels", "3", "--output", str(output))
    code, out, _ = run(capsys, *arguments, "--json")
    result = json.loads(out)
    assert code == 0
    assert np.array(result["T_last_file"])[2].tolist() == np.eye(4).tolist()
    # Voxel means of 3 mm and tangent planes at corresponding points some 2 mm away: 2^2 / 2r = .13 mm.
    np.testing.assert_allclose(np.array(result["T_last_file"])[:, 1:3, 3], wanted[:, 1:], atol=0.2)
    assert len(read_points(output).xyz_mm) == 12_000
    assert all(pair["unseen_directions"] for pair in result["pairs"])
    code, out, _ = run(capsys, *arguments)
    assert "overlap" in out


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["a.ply"], "scans: expected two files or more, got 1"),
        (["a.ply", "b.ply", "c.ply"], "--voxels: are needed for more than two scans"),
    ],
)
def test_register_says_what_it_lacks(capsys, arguments, reason):
    code, _, err = run(capsys, "register", *arguments, "--unit", "mm")
    assert (code, reason in err) == (1, True)


def test_register_of_scans_far_apart_says_what_helps(capsys, scan, tmp_path):
    far = tmp_path / "far.ply"
    write_points(far, bent_cable(n=2000) + 1e4)
    arguments = ("register", str(far), scan, "--unit", "mm", "--quiet")
    code, _, err = run(capsys, *arguments, "--max-distance", "5")
    assert (code, "too few points lie near the target: leave --max-distance out" in err) == (1, True)
    code, out, _ = run(capsys, *arguments)  # nothing given: the centres are brought together first
    assert code == 0
    assert "centres, voxels of" in out


@pytest.mark.parametrize("points", range(6))
def test_register_refuses_a_handful_of_points(capsys, scan, tmp_path, points):
    few = tmp_path / "few.xyz"
    few.write_text("".join(f"{i} 0 {i * i}\n" for i in range(points)))
    for options in ([], ["--voxels", "5"], ["--max-distance", "5"]):
        code, _, err = run(capsys, "register", str(few), scan, "--unit", "mm", "--quiet", *options)
        assert code == 1
        assert f"source: expected at least 6 points, got {points}" in err or points == 0


def test_report_writes_the_page(capsys, scan, tmp_path):
    code, out, _ = run(capsys, "report", scan, str(tmp_path / "page.html"), "--unit", "mm", "--quiet")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert code == 0
    assert "diameter" in out
    for wanted in (
        "bend radius of at least 12 D",
        "bend radius of at least 20 D",
        "least and greatest of all sections",
    ):
        assert wanted in text


REFUSALS = {
    "missing.ply": "does not exist",
    "empty.ply": "is empty",
    "prose.txt": "prose.txt",
    "folder.ply": "is a folder",
    "plane.xyz": "lie on a plane",
    "three.xyz": "Too few points: 3",
    "equal.xyz": "are equal",
    "sliver.xyz": "degrees of the circumference",
    "misses.xyz": "at the origin",
}


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    """A folder of files that give no result."""
    folder = tmp_path_factory.mktemp("bad")
    rng = np.random.default_rng(0)
    flat = np.stack([rng.uniform(0, 500, 3000), rng.uniform(0, 400, 3000), np.zeros(3000)], axis=1)
    write_points(folder / "plane.xyz", flat)
    write_points(folder / "three.xyz", np.eye(3))
    write_points(folder / "equal.xyz", np.ones((100, 3)))
    write_points(folder / "sliver.xyz", bent_cable(arc_deg=25.0, noise=0.02))
    (folder / "empty.ply").write_text("")
    (folder / "prose.txt").write_text("this is no cloud\nat all\n")
    (folder / "folder.ply").mkdir()
    (folder / "misses.xyz").write_text("0 0 0\n" * 80)
    return folder


@pytest.mark.parametrize("name", REFUSALS)
def test_no_result_is_exit_code_one_and_one_line(capsys, bad, name):
    code, out, err = run(capsys, "measure", str(bad / name), "--unit", "mm", "--quiet")
    assert code == 1
    assert out == ""
    assert err.startswith("cablejax: ")
    assert err.count("\n") == 1
    assert REFUSALS[name] in err


def test_a_tenth_of_nan_is_left_out(capsys, tmp_path):
    rows = [" ".join(f"{value:.5f}" for value in row) for row in bent_cable(n=3000)]
    rows[::10] = ["nan nan nan"] * 300
    (tmp_path / "nan.xyz").write_text("\n".join(rows))
    code, out, _ = run(capsys, "measure", str(tmp_path / "nan.xyz"), "--unit", "mm", "--json")
    result = json.loads(out)
    assert code == 0
    assert result["dropped"] == 300
    assert result["diameter_mm"] == pytest.approx(30, abs=0.05)


@pytest.mark.parametrize("arguments", [[], ["measure"], ["measure", "a.ply", "--unit", "parsec"], ["polish", "a.ply"]])
def test_wrong_usage_is_exit_code_two(capsys, arguments):
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2
    assert "usage: cablejax" in capsys.readouterr().err


def test_outputs_are_checked_before_the_work(capsys, scan, tmp_path):
    for output, reason in (("clean.docx", "endings"), ("no/such/clean.ply", "does not exist")):
        code, _, err = run(capsys, "denoise", scan, str(tmp_path / output), "--unit", "mm")
        assert code == 1
        assert reason in err


def test_unknown_sizes_and_voltages_are_named(capsys, scan, tmp_path):
    code, _, err = run(capsys, "measure", scan, "--unit", "mm", "--catalogue", "400/500")
    assert (code, "--catalogue 400/500" in err) == (1, True)
    code, _, err = run(capsys, "simulate", str(tmp_path / "a.ply"), "--size", "77")
    assert (code, "size: expected one of 25" in err) == (1, True)


def test_importing_the_command_is_light():
    code = f"import sys, cablejax.cli; print([m for m in {HEAVY!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_a_folder_gives_one_csv_with_results_and_reasons(capsys, scan, tmp_path):
    (tmp_path / "a.ply").write_bytes(Path(scan).read_bytes())
    write_points(tmp_path / "b.xyz", np.eye(3))
    table = tmp_path / "out.csv"
    code, out, _ = run(capsys, "measure", str(tmp_path), "--unit", "mm", "--csv", str(table), "--tolerance", "29", "31")
    with table.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert code == 0
    assert "b.xyz  no result: Too few points: 3" in out
    assert [Path(row["file"]).name for row in rows] == ["a.ply", "b.xyz"]
    assert float(rows[0]["low_mm"]) < 30 < float(rows[0]["high_mm"])
    assert rows[0]["conformity"] == "pass"
    assert "Too few points" in rows[1]["error"]


@pytest.mark.parametrize(("place", "why"), [("taken", "is a file"), ("taken/below", "Not a directory")])
def test_a_folder_for_results_that_cannot_be_made_is_named(capsys, scan, tmp_path, place, why):
    (tmp_path / "taken").write_text("")
    page = tmp_path / place / "page.html"
    code, out, err = run(capsys, "measure", scan, "--unit", "mm", "--quiet", "--report", str(page))
    assert (code, out) == (1, "")
    assert err == f"cablejax: {page.parent}: cannot be a folder for results ({why})\n"


def test_a_folder_without_a_result_is_exit_code_one(capsys, tmp_path):
    code, _, err = run(capsys, "measure", str(tmp_path), "--unit", "mm")
    assert (code, "is a folder without point files" in err) == (1, True)
    write_points(tmp_path / "b.xyz", np.eye(3))
    code, _, err = run(capsys, "measure", str(tmp_path), "--unit", "mm", "--quiet")
    assert (code, "none of 1 files gave a result" in err) == (1, True)


def test_metres_are_inferred_with_a_warning(capsys, tmp_path):
    write_points(tmp_path / "metres.xyz", bent_cable(n=2000) / 1000)
    code, out, err = run(capsys, "info", str(tmp_path / "metres.xyz"), "--json")
    assert code == 0
    assert "taken to be in m: its longest side is 0.4" in err
    assert json.loads(out)["maximum_mm"][0] == pytest.approx(400, rel=0.01)


def test_tolerances_must_be_in_order(capsys, scan):
    code, _, err = run(capsys, "measure", scan, "--unit", "mm", "--tolerance", "31", "29")
    assert (code, "--tolerance: expected LOW below HIGH, got 31 29" in err) == (1, True)


def test_completion_knows_commands_options_and_choices(capsys):
    code, out, _ = run(capsys, "completion", "bash")
    assert code == 0
    asked = "COMP_WORDS=(cablejax {}); COMP_CWORD={}; _cablejax; echo ${{COMPREPLY[@]}}"
    for words, place, expected in (
        ("mea", 1, "measure"),
        ("register --me", 2, "--method"),
        ("info --unit m", 3, "mm m"),
    ):
        script = out + asked.format(words, place)
        done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
        assert done.stdout.split() == expected.split()


def test_classify_wants_a_run_of_the_trainer(capsys, scan, tmp_path):
    code, _, err = run(capsys, "classify", scan, "--unit", "mm", "--checkpoint", str(tmp_path))
    assert (code, "no run.json" in err) == (1, True)


def test_classify_takes_a_network_of_the_package(capsys, scan):
    code, out, err = run(capsys, "classify", scan, "--unit", "mm", "--json")
    assert code == 0
    found = json.loads(out)
    assert set(found) == set(read_schema("classify")["properties"])
    assert found["model"] == "adgcnn_fit"
    assert found["network"] in err
    assert found["size_mm2"] == "150"  # 30.1 mm; the scan's cable has 30
    assert sum(found["probabilities"].values()) == pytest.approx(1)


def test_classify_refuses_a_network_that_is_none(capsys, scan):
    code, out, err = run(capsys, "classify", scan, "--unit", "mm", "--quiet", "--network", "lenet")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "--network: expected one of adgcnn" in err


@pytest.fixture(scope="module")
def parts_run(tmp_path_factory):
    """A run of experiments.parts whose network has learnt nothing, on clouds that are none."""
    from flax import nnx

    from cablejax.io import write_json
    from cablejax.nets import PartNetwork
    from cablejax.simulate import PARTS, PartSplit
    from cablejax.train import TrainConfig, fit

    folder, options = (
        tmp_path_factory.mktemp("runs") / "parts",
        {"k": 4, "widths": [8, 8], "shared_width": 8, "head": [8]},
    )
    xyz = np.random.default_rng(0).normal(size=(4, 64, 3)).astype(np.float32)
    clouds = PartSplit(xyz, np.ones((4, 64), bool), np.zeros((4, 64), np.int32))
    model = PartNetwork(len(PARTS), rngs=nnx.Rngs(0), **options)
    fit(model, clouds, clouds, TrainConfig(epochs=1, batch_size=4, keep_best=True), folder=folder, progress=False)
    config = {"model": {"options": options}, "parts": {"n_points": 64, "ball_mm": 120.0}}
    write_json(folder / "run.json", {"config": config, "metrics": {"parts": list(PARTS)}})
    return folder


def labelled_as(part, monkeypatch):
    """Let the network say `part` of every third point, and cable of the others."""
    from cablejax import nets

    def label(model, xyz_mm, **options):
        assert options == {"n_points": 64, "ball_mm": 120.0, "seed": 0}
        return nets.PartLabels(np.where(np.arange(len(xyz_mm)) % 3 == 0, part, 0), np.empty((len(xyz_mm), 5)))

    monkeypatch.setattr(nets, "label_parts", label)


def test_measure_takes_a_networks_labels(capsys, scan, parts_run, monkeypatch, tmp_path):
    labelled_as(4, monkeypatch)
    page = tmp_path / "report.html"
    arguments = ("measure", scan, "--unit", "mm", "--checkpoint", str(parts_run), "--report", str(page))
    code, out, err = run(capsys, *arguments)
    assert code == 0
    assert re.search(r"cable 66\.[67] %, surroundings 33\.[34] %", out)
    assert "labelling 4,000 points" in err
    assert "As a network labelled the scan" in page.read_text(encoding="utf-8")
    _, out, _ = run(capsys, *arguments, "--json")
    result = json.loads(out)
    assert result["parts"] == {"cable": 2666, "surroundings": 1334}
    assert result["points"] <= 2666


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """A cylinder of 60 mm and, 200 mm beside it, one of 24 mm on fewer points."""
    path = tmp_path_factory.mktemp("beside") / "two.ply"
    wide, thin = (bent_cable(n=n, radius=r, arc_deg=200, seed=n) for n, r in ((1500, 30.0), (500, 12.0)))
    write_points(path, np.concatenate([wide, thin + np.array([0.0, 200.0, 0.0])]))
    return str(path)


def package_says(part, monkeypatch):
    """Let the labeller of the package say these parts."""
    from cablejax import nets
    from cablejax.simulate import PARTS

    clouds = {"n_points": 64, "ball_mm": 120.0, "diameter_mm": [10.0, 60.0]}
    monkeypatch.setattr(
        nets, "load_pretrained", lambda name: nets.Pretrained(None, {"clouds": clouds, "classes": PARTS})
    )
    monkeypatch.setattr(nets, "label_parts", lambda *_, **__: nets.PartLabels(part, np.empty((len(part), 5))))


def test_measure_tells_both_candidates_where_labels_disagree(capsys, beside, monkeypatch):
    package_says(np.where(np.arange(2000) < 1500, 4, 0), monkeypatch)
    code, out, err = run(capsys, "measure", beside, "--unit", "mm", "--labels", "auto")
    assert code == 0
    assert re.search(r"candidates +search 60\.\d+ mm, labels 2[34]\.\d+ mm", out)
    assert re.search(r"note: Two candidates: .*The latter is told", out)
    assert "labelling 2,000 points" in err
    result = json.loads(run(capsys, "measure", beside, "--unit", "mm", "--labels", "auto", "--json")[1])
    assert result["parts"] == {"surroundings": 1500, "cable": 500}
    assert result["candidates"]["taken"] == "labels"
    assert result["diameter_mm"] == result["candidates"]["labels_mm"]


def test_measure_without_labels_asks_no_network(capsys, beside, scan, monkeypatch):
    from cablejax import nets

    monkeypatch.setattr(nets, "load_pretrained", None)
    for arguments in ((beside, "--labels", "off"), (scan, "--labels", "auto")):  # the other lies alone
        code, out, err = run(capsys, "measure", *arguments, "--unit", "mm", "--json")
        assert code == 0
        assert json.loads(out)["parts"] is None
        assert "labelling" not in err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--labels", "auto", "--all"), "--labels auto: is for one cable, not for --all"),
        (("--labels", "auto", "--checkpoint", "x"), "not allowed with argument --labels"),
        (("--labels", "on"), "invalid choice: 'on'"),
    ],
)
def test_labels_that_cannot_be_asked_for(capsys, scan, arguments, text):
    try:
        code, out, err = run(capsys, "measure", scan, *arguments)
    except SystemExit as stopped:
        code, (out, err) = stopped.code, capsys.readouterr()
    assert code in (1, 2)
    assert out == ""
    assert text in err


def test_the_network_itself_labels_every_point(capsys, scan, parts_run):
    _, out, err = run(capsys, "measure", scan, "--unit", "mm", "--checkpoint", str(parts_run), "--json")
    assert "labelling 4,000 points" in err
    # It has seen the class "cable" alone for one step: whatever it says, each point has a label.
    assert out == "" or sum(json.loads(out)["parts"].values()) == 4000


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            lambda run: (run / "run.json").unlink(),
            "no run.json; give the folder of a finished run of experiments.parts",
        ),
        (
            lambda run: (run / "run.json").write_text('{"metrics": {"labels_mm2": []}}'),
            "trained no network that labels parts; give one of experiments.parts",
        ),
        (lambda run: [one.unlink() for one in (run / "checkpoints").iterdir()], "no whole checkpoint"),
    ],
    ids=["no record", "another experiment", "no checkpoint"],
)
def test_a_folder_that_holds_no_such_network_is_named(capsys, scan, parts_run, tmp_path, change, text):
    copy = tmp_path / "run"
    shutil.copytree(parts_run, copy)
    change(copy)
    code, _, err = run(capsys, "measure", scan, "--unit", "mm", "--checkpoint", str(copy), "--quiet")
    assert code == 1
    assert f"--checkpoint {copy}" in err
    assert text in err
    assert "Traceback" not in err


def test_measure_takes_a_scanner(capsys, scan):
    for given in ("line-laser", "range_std_mm=0.05,footprint_mm=0.1"):
        code, out, _ = run(capsys, "measure", scan, "--unit", "mm", "--scanner", given)
        assert code == 0
        assert "(95 %: 29." in out


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("leica", "expected one of ideal, structured-light"),
        ("footprint_mm=1", "expected range_std_mm, and no other names than range_std_mm, incidence_power"),
        ("range_std_mm=1,width=2", "and no other names than"),
        ("range_std_mm=-1", "range_std_mm: expected a number of at least 0, got -1.0"),
        ("range_std_mm=wide", "could not convert string to float: 'wide'"),
    ],
)
def test_a_scanner_that_is_none_is_named(capsys, scan, given, text):
    code, _, err = run(capsys, "measure", scan, "--unit", "mm", "--scanner", given, "--quiet")
    assert code == 1
    assert f"--scanner {given}" in err
    assert text in err


@pytest.mark.parametrize("header", ["", "x[m] y[m] z[m]\n"])
def test_tiles_take_the_unit_that_the_whole_file_would(tmp_path, capsys, header):
    """A cable in metres, whose file says so or not: in mm its points would be all in one tile of a millimetre."""
    source = tmp_path / "cable.xyz"
    lines = "\n".join(" ".join(f"{value:.7f}" for value in point) for point in bent_cable(n=3000) / 1000)
    source.write_text(header + lines + "\n")
    told = []
    for name, more in (("whole.ply", ()), ("tiles.ply", ("--tile", "2048", "--jobs", "0"))):
        command = ["denoise", str(source), str(tmp_path / name), "--neighbors", "12", "--no-filter", "--json", *more]
        code, out, err = run(capsys, *command)
        assert code == 0
        assert ("taken to be in m:" in err) == (not header)
        told.append(json.loads(out))
    assert told[0]["removed"] == told[1]["removed"] > 0
    whole, tiles = (read_points(tmp_path / name, unit="m").xyz_mm for name in ("whole.ply", "tiles.ply"))
    np.testing.assert_allclose(tiles, whole, atol=1e-3)
    assert np.ptp(tiles, axis=0).max() > 30
