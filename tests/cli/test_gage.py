"""`cablejax gage`: the study of scans whose variation is known, and folders that are no study."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cablejax.cli import main
from cablejax.io import write_points
from tests.reference.circles import bent_cable

RADII = {"c1": 15.0, "c2": 15.5, "c3": 16.0}
SHIFT = {"anna": 0.0, "bo": 0.03}


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Three parts, two operators whose diameters are 0.06 mm apart, two trials."""
    folder, seed = tmp_path_factory.mktemp("gage") / "scans", 0
    folder.mkdir()
    for part, radius in RADII.items():
        for operator, shift in SHIFT.items():
            for trial in (1, 2):
                seed += 1
                xyz = bent_cable(n=1500, arc_deg=360, radius=radius + shift, seed=seed)
                write_points(folder / f"{part}_{operator}_{trial}.ply", xyz)
    return folder


@pytest.fixture
def copied(scans, tmp_path):
    """A copy with the times of change, and the table of those that are measured already."""
    assert study(scans) == 0
    shutil.copytree(scans, tmp_path / "scans")
    shutil.copy(scans.parent / "t.csv", tmp_path / "t.csv")
    return tmp_path / "scans"


def study(folder: Path, *more: str) -> int:
    table = folder.parent / "t.csv"
    same = ["--unit", "mm", "--tolerance", "29", "33", "--quiet", "--jobs", "0", "--csv", str(table)]
    return main(["gage", str(folder), *same, *more])


def test_the_components_are_those_of_the_scans(scans, tmp_path, capsys):
    chart = tmp_path / "chart.png"
    assert study(scans, "--json", "--chart", str(chart)) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["parts"], found["operators"], found["trials"]) == (["c1", "c2", "c3"], ["anna", "bo"], 2)
    assert found["reproducibility"] == pytest.approx(0.06 / np.sqrt(2), rel=0.4)
    assert found["part"] == pytest.approx(1.0, rel=0.05)  # of diameters 30, 31, 32
    assert found["repeatability"] < 0.02
    assert found["percent_tolerance"] == pytest.approx(100 * 6 * found["gage"] / 4)
    assert found["categories"] == int(1.41 * found["part"] / found["gage"])
    diameters = np.array(found["diameters_mm"])
    np.testing.assert_allclose(diameters[:, 0].mean(axis=1), [30, 31, 32], atol=0.05)
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_a_plan_in_place_of_names(copied, capsys):
    lines = ["file,part,operator"]
    for path in sorted(copied.iterdir()):
        part, operator, _ = path.stem.split("_")
        # One name tells nothing, so that the plan is needed; the others are measured already under theirs.
        name = "scan.ply" if path.name == "c1_anna_1.ply" else path.name
        path.rename(copied / name)
        lines.append(f"{name},{part},{operator}")
    plan = copied.parent / "plan.csv"
    plan.write_text("\n".join(lines))
    assert study(copied, "--plan", str(plan)) == 0
    assert "3 parts, 2 operators, 2 trials" in capsys.readouterr().out
    plan.write_text("\n".join(lines[:-1]))
    assert study(copied, "--plan", str(plan)) == 1
    assert "has no line for c3_bo_2.ply" in capsys.readouterr().err
    plan.write_text("name,part\n")
    assert study(copied, "--plan", str(plan)) == 1
    assert "expected the columns file, part, operator, file, operator missing" in capsys.readouterr().err


def test_without_operators_it_is_repeatability_alone(scans, capsys):
    assert study(scans, "--pattern", "{part}_{trial}", "--json") == 0  # c1_anna is a part
    found = json.loads(capsys.readouterr().out)
    assert (found["operators"], found["reproducibility"], len(found["parts"])) == (["all"], 0, 6)


@pytest.mark.parametrize(
    ("change", "more", "text"),
    [
        (lambda f: (f / "c1_anna_1.ply").unlink(), (), "part c1, operator anna: 1 trials where others have 2"),
        (lambda f: (f / "c1_anna_1.ply").write_text(""), (), "c1_anna_1.ply: has no diameter: is empty"),
        (lambda f: (f / "c1_anna_1.ply").rename(f / "odd.ply"), (), "does not fit odd.ply"),
        (lambda f: None, ("--pattern", "{trial}"), "--pattern {trial}: expected {part}"),
        (lambda f: None, ("--pattern", "{part}_{part}"), "each once"),
        (lambda f: None, ("--plan", "no/such.csv"), "--plan no/such.csv: cannot be read (No such file"),
    ],
)
def test_what_is_no_study_is_one_line(copied, capsys, change, more, text):
    change(copied)
    assert study(copied, *more) == 1
    err = capsys.readouterr().err
    assert text in err
    assert err.count("\n") == 1


def test_a_file_is_no_folder(scans, capsys):
    assert main(["gage", str(scans / "c1_anna_1.ply"), "--unit", "mm"]) == 1
    assert "expected a folder of scans" in capsys.readouterr().err
