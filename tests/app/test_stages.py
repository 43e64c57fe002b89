"""The work on a scan of the page's desk gives what `cablejax measure` gives, number for number and word for word."""

import json

import numpy as np
import pytest

from cablejax.cli import main, measure_input
from cablejax.cli.app_stages import STAGES, stage
from cablejax.io import write_points
from tests.app.scans import two_cables
from tests.reference.circles import bent_cable


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the scans, for they are named as the user names them."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def work(name: str, *arguments: str, until: str = "report") -> dict:
    """What all stages together have found, an error of the last."""
    found = {}
    for one in STAGES:
        found |= stage(one, name, [*arguments], ".")
        if one == until:
            break
    return found


def printed(capsys, *arguments: str) -> dict:
    assert main(["measure", *arguments, "--json", "--quiet"]) == 0
    return json.loads(capsys.readouterr().out)


def test_one_cable_is_that_of_measure(folder, capsys):
    write_points("a.ply", bent_cable(n=1500))
    found = work("a.ply", "--unit", "mm", "--tolerance", "29", "31", "--catalogue", "8.7/15")
    expected = printed(capsys, "a.ply", "--unit", "mm", "--tolerance", "29", "31", "--catalogue", "8.7/15")
    (one,) = found["cables"]
    for name in (
        "diameter_mm",
        "interval_mm",
        "warnings",
        "budget",
        "readings",
        "conformity",
        "verdict",
        "section_sizes",
    ):
        assert one[name] == expected[name]
    assert (found["error"], found["every"], found["reports"]) == (None, False, ["1"])
    assert f"a.ply: {one['diameter_mm']:.2f} mm" in (folder / "report-1.html").read_text()


def test_several_cables_are_those_of_measure_all_each_with_its_report(folder, capsys):
    write_points("a.ply", two_cables(1500))
    found = work("a.ply", "--unit", "mm")
    expected = printed(capsys, "a.ply", "--unit", "mm", "--all")
    assert [one["diameter_mm"] for one in found["cables"]] == [one["diameter_mm"] for one in expected["cables"]]
    assert len(found["cables"]) == 2
    assert (found["every"], found["reports"]) == (True, ["1", "2", "all"])
    assert "a.ply, cable 2" in (folder / "report-2.html").read_text()
    assert all((folder / f"surface-{number}.npy").exists() for number in (1, 2))


def test_a_region_leaves_one_of_two(folder):
    xyz = two_cables(1500)
    write_points("a.ply", xyz)
    near = xyz[xyz[:, 1] < 30]
    box = [f"{x:.3f}" for corner in (near.min(axis=0) - 1, near.max(axis=0) + 1) for x in corner]
    found = work("a.ply", "--unit", "mm", "--box", *box, until="every")
    (one,) = found["cables"]
    assert abs(one["diameter_mm"] - 20) < 5 * one["std_mm"]
    assert found["cloud"]["of"] == len(xyz)  # all are drawn, for another region


AXES = b"".join(b"property float %c\n" % axis for axis in b"xyz")
WRONG = {
    "empty": (b"", []),
    "truncated": (b"ply\nformat ascii 1.0\nelement vertex 5\n" + AXES + b"end_header\n0 0 0\n", []),
    "no points": (b"hello\n", []),
    "no cable": (None, []),
    "limits the wrong way": (b"", ["--tolerance", "3", "2"]),
    "no such catalogue": (b"", ["--catalogue", "1/2"]),
    "diameters the wrong way": (b"", ["--diameter", "3", "2"]),
    "a flat box": (b"", ["--box", "0", "0", "0", "0", "1", "1"]),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_measured_is_told_in_the_commands_sentence(folder, capsys, case):
    content, arguments = WRONG[case]
    name = "a.xyz"
    if content is None:
        np.savetxt(name, np.random.default_rng(1).uniform(0, 100, (1000, 3)))
    else:
        (folder / name).write_bytes(content)
    assert main(["measure", name, "--unit", "mm", *arguments, "--quiet"]) == 1
    sentence = capsys.readouterr().err.strip().removeprefix("cablejax: ")
    read = stage("read", name, ["--unit", "mm", *arguments], ".")
    found = read if read["error"] is not None else work(name, "--unit", "mm", *arguments, until="every")
    assert found["error"] == sentence


def test_one_thing_that_measure_refuses_is_none_of_several(folder, monkeypatch):
    """In mere noise the search for several may take for a cable what the closer look at one does not."""
    from cablejax.measure import MeasureError

    def refuse(*_, **__):
        raise MeasureError("No cable found.")

    write_points("a.ply", bent_cable(n=1500))
    monkeypatch.setattr(measure_input, "measured", refuse)
    assert work("a.ply", "--unit", "mm", until="every")["error"] == "a.ply: No cable found."
    write_points("a.ply", two_cables(1500))
    found = work("a.ply", "--unit", "mm", until="every")
    assert (found["error"], len(found["cables"])) == (None, 2)
    assert found["scene_warnings"] == [
        "`cablejax measure`, which looks for one cable alone, gives no result: a.ply: No cable found."
    ]


def test_what_is_no_option_is_told_and_does_not_end_the_process(folder):
    assert (
        stage("read", "a.ply", ["--unit", "furlong"], ".")["error"]
        == "--unit furlong: are no options of `cablejax measure`"
    )


def test_what_is_odd_about_a_file_is_told_without_options(folder):
    write_points("a.ply", bent_cable(n=500) / 1000)
    (warning,) = stage("read", "a.ply", [], ".")["warnings"]
    assert warning.startswith("no unit was chosen, the file is taken to be in m")


def test_a_file_is_read_anew_each_time_the_work_is_begun(folder):
    for n in (500, 700):
        write_points("a.ply", bent_cable(n=n))
        assert stage("read", "a.ply", ["--unit", "mm"], ".")["cloud"]["of"] == n
