"""Results repeated on another processor: what differs by rounding is the same, what differs by more is named."""

import copy
import math

import pytest

from cablejax.io import read_json
from experiments import ROOT
from experiments.verify import SAMPLES, differences

SAMPLE = SAMPLES["diameter"]


@pytest.fixture(scope="module")
def committed():
    """The run that `make verify` repeats: a straight cable, its filtered points here bent by a radius of 72 m."""
    runs = read_json(ROOT / "results" / "diameter.json")["runs"]
    metrics = next(row for row in runs if row["cell"]["scan.preset"] == "line-laser" and row["seed"] == 0)["metrics"]
    bend = {"bend_radius_mm": 71_891.0, "bend_interval_mm": [60_000.0, 90_000.0]}
    return {**metrics, "filtered": {**metrics["filtered"], **bend}}


def changed(metrics, path, value):
    again = copy.deepcopy(metrics)
    *folders, name = path.split(".")
    place = again
    for folder in folders:
        place = place[folder]
    place[name] = value
    return again


def test_the_same_is_the_same(committed):
    assert differences(committed, committed, SAMPLE) == []


def test_a_bend_radius_within_its_own_interval_is_the_same(committed):
    # 71,891 mm on one processor and 73,782 on the next, and no bend at all on the scan as it came.
    assert differences(committed, changed(committed, "filtered.bend_radius_mm", 73_782.0), SAMPLE) == []
    assert differences(committed, changed(committed, "raw.bend_radius_mm", 2e7), SAMPLE) == []


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("filtered.bend_radius_mm", 50_000.0),
        ("filtered.bend_radius_mm", None),
        ("raw.bend_radius_mm", 71_891.0),
        ("raw.diameter_mm", 34.25),
        ("raw.diameter_mm", math.nan),
        ("filtered.noise_mm", 0.03),
    ],
)
def test_what_differs_by_more_is_named(committed, path, value):
    (line,) = differences(committed, changed(committed, path, value), SAMPLE)
    assert line.startswith(path.replace("bend_radius_mm", "bend_sagitta_mm"))


def test_a_number_that_has_gone_is_named(committed):
    again = copy.deepcopy(committed)
    del again["raw"]["std_mm"]
    assert [line.split(":")[0] for line in differences(committed, again, SAMPLE)] == ["raw.std_mm"]
