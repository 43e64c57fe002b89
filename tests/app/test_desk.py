"""The desk: one scan after the other in a process of its own, given up, measured anew, taken away."""

import time
from pathlib import Path

import pytest

from cablejax.app import Desk
from tests.app.stages import CABLE


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    one = Desk("tests.app.stages:stage", tmp_path_factory.mktemp("desk"))
    yield one
    one.close()


def put(desk: Desk, folder: Path, name: str, content: str = "") -> int:
    (folder / name).write_text(content)
    return desk.add(folder / name, {"unit": "mm"})


def settled(desk: Desk, number: int, *stages: str) -> dict:
    """A scan when it has come to a stage."""
    end = time.monotonic() + 60
    while (found := desk.scan(number))["stage"] not in (stages or ("done", "stopped")):
        assert time.monotonic() < end, found
        time.sleep(0.01)
    return found


def test_scans_are_worked_on_one_after_the_other_each_through_all_stages(desk, tmp_path):
    numbers = [put(desk, tmp_path, f"{i}.ply") for i in range(3)]
    for i, number in enumerate(numbers):
        found = settled(desk, number)
        assert (found["stage"], found["error"], found["cables"]) == ("done", None, [CABLE])
        assert found["name"] == f"{i}.ply"
        assert found["command"] == f"cablejax measure {i}.ply --unit mm"
        path, name = desk.file(number, "report-1.html")
        assert (path.read_text(), name) == ("<p>report</p>", f"{i}.ply")
        ran = (path.parent / "ran").read_text().splitlines()
        assert ran == [f"{stage} --unit mm" for stage in ("read", "measure", "every", "report")]
        desk.remove(number)
    assert desk.scans() == []


FAILURES = {
    "no cable at all": ("measure no\nevery no", "x.ply: every found nothing", 0),
    "none alone but among several": ("measure no", None, 0),
    "an unreadable file": ("read no", "x.ply: read found nothing", 0),
    "a crash": ("measure die\nevery die", "its process crashed (SIGABRT), 3 times", 0),
    "a defect": ("read defect", "a defect of this program, please report it: RuntimeError: a bug", 0),
    "reports alone": ("report no", "x.ply: report found nothing", 1),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_failure_is_a_sentence_and_the_next_scan_is_measured(desk, tmp_path, failure):
    content, sentence, cables = FAILURES[failure]
    bad, good = put(desk, tmp_path, "x.ply", content), put(desk, tmp_path, "good.ply")
    found = settled(desk, bad)
    assert (found["error"], len(found["cables"])) == (sentence, cables)
    assert settled(desk, good)["cables"] == [CABLE]
    for number in (bad, good):
        desk.remove(number)


def test_work_is_given_up_at_once_and_can_be_begun_anew(desk, tmp_path):
    slow, waiting = put(desk, tmp_path, "slow.ply", "measure slow"), put(desk, tmp_path, "waiting.ply")
    settled(desk, slow, "measuring")
    begun = time.monotonic()
    desk.stop(slow)
    assert settled(desk, slow)["stage"] == "stopped"
    assert settled(desk, waiting)["stage"] == "done"
    assert time.monotonic() - begun < 50  # of the 60 s that it would have slept
    (tmp_path / "slow.ply").write_text("")
    desk.again(slow, {"unit": "m", "box": [0, 0, 0, 1, 1, 1]})
    found = settled(desk, slow)
    assert (found["stage"], found["settings"]["unit"], found["cables"]) == ("done", "m", [CABLE])
    assert "--box 0 0 0 1 1 1" in found["command"]
    for number in (slow, waiting):
        desk.remove(number)


def test_a_scan_that_waits_is_not_begun_when_it_is_stopped_or_removed(desk, tmp_path):
    slow = put(desk, tmp_path, "slow.ply", "read slow")
    settled(desk, slow, "reading")
    stopped, removed = put(desk, tmp_path, "stopped.ply"), put(desk, tmp_path, "removed.ply")
    desk.stop(stopped)
    desk.remove(removed)
    desk.remove(slow)  # in the middle of its work
    last = put(desk, tmp_path, "last.ply")
    settled(desk, last)
    assert desk.scan(stopped)["stage"] == "stopped"
    assert [one["number"] for one in desk.scans()] == [stopped, last]
    with pytest.raises(KeyError):
        desk.scan(removed)
    for number in (stopped, last):
        desk.remove(number)


def test_what_is_removed_leaves_nothing_but_the_users_file(desk, tmp_path):
    place = desk.place()
    (place / "up.ply").write_text("")
    uploaded, opened = desk.add(place / "up.ply", {}, own=True), put(desk, tmp_path, "mine.ply")
    folders = [desk.file(number, "ran")[0].parent for number in (uploaded, opened) if settled(desk, number)]
    for number in (uploaded, opened):
        desk.remove(number)
    assert not any(folder.exists() for folder in (*folders, place))
    assert (tmp_path / "mine.ply").exists()


@pytest.mark.parametrize("name", ["../ran", "nothing", ".", ""])
def test_no_other_file_is_given_out(desk, tmp_path, name):
    number = put(desk, tmp_path, "a.ply")
    settled(desk, number)
    with pytest.raises(KeyError):
        desk.file(number, name)
    desk.remove(number)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"units": "mm"}, "units: expected one of unit, catalogue"),
        ({"unit": "--all"}, "unit: expected a word, got '--all'"),
        ({"unit": 3}, "unit: expected a word, got 3"),
        ({"box": [1, 2]}, "box: expected 6 numbers"),
        ({"tolerance": [1, "2"]}, "tolerance: expected 2 numbers"),
        ({"tolerance": [1, float("nan")]}, "tolerance: expected 2 numbers"),
        ({"diameter": [True, 2]}, "diameter: expected 2 numbers"),
    ],
)
def test_settings_that_are_none_are_refused(desk, tmp_path, settings, sentence):
    with pytest.raises(ValueError, match="expected") as error:
        desk.add(tmp_path / "a.ply", settings)
    assert str(error.value).startswith(sentence)
    assert desk.scans() == []
