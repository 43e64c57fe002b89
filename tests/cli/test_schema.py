"""What every command prints with `--json`, against its schema."""

import json

import numpy as np
import pytest

from cablejax.cli import main
from cablejax.cli.main import COMMANDS
from cablejax.cli.schema import FOLDER, VERSIONS, read_schema
from cablejax.io import write_points
from cablejax.measure.uncertainty import budget
from tests.reference.circles import bent_cable

jsonschema = pytest.importorskip("jsonschema")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """A half seen straight cable, a bent one seen all round that carries a bulge, and a folder."""
    folder = tmp_path_factory.mktemp("scans")
    write_points(folder / "half.ply", bent_cable(n=2000))
    round_ = bent_cable(n=8000, arc_deg=360, bend_radius=500.0)
    write_points(folder / "round.ply", round_)
    (folder / "several").mkdir()
    for name in ("a_x_1", "a_x_2", "b_x_1", "b_x_2"):
        write_points(
            folder / "several" / f"{name}.ply", bent_cable(n=1500, radius=15 + (name[0] == "b"), seed=len(name))
        )
    write_points(folder / "several" / "b_x_2.ply", bent_cable(n=1500, radius=16, seed=3))
    return folder


def printed(capsys, *arguments: str) -> dict:
    assert main([*arguments, "--json", "--quiet"]) == 0
    return json.loads(capsys.readouterr().out)


IN_MM = ("--unit", "mm")
CALLS = {
    "measure half": ("measure", ["measure", "half.ply", *IN_MM]),
    "measure round": ("measure", ["measure", "round.ply", *IN_MM, "--tolerance", "29", "31", "--catalogue", "8.7/15"]),
    "measure all": ("measure-all", ["measure", "round.ply", *IN_MM, "--all", "--tolerance", "29", "31"]),
    "measure all with exports": ("measure-all", ["measure", "half.ply", *IN_MM, "--all", "--export", "OUT", "--formats", "csv"]),
    "report": ("measure", ["report", "half.ply", "OUT/report.html", *IN_MM]),
    "info": ("info", ["info", "half.ply", *IN_MM]),
    "denoise": ("denoise", ["denoise", "half.ply", "OUT/clean.ply", *IN_MM, "--neighbors", "20"]),
    "denoise without filter": ("denoise", ["denoise", "half.ply", "OUT/clean.ply", *IN_MM, "--no-filter"]),
    "denoise in tiles": (
        "denoise", ["denoise", "half.ply", "OUT/clean.ply", *IN_MM, "--tile", "2048", "--no-filter", "--jobs", "0"]
    ),
    "register": ("register", ["register", "half.ply", "half.ply", *IN_MM]),
    "register three": ("register-stations", ["register", "half.ply", "half.ply", "half.ply", *IN_MM, "--voxels", "8"]),
    "simulate": ("simulate", ["simulate", "OUT/sim.ply", "--points", "2000"]),
    "folder of info": ("folder", ["info", "several", *IN_MM, "--jobs", "0", "--csv", "OUT/t.csv"]),
    "folder of measure": ("folder", ["measure", "several", *IN_MM, "--jobs", "0"]),
    "gage": ("gage", ["gage", "several", *IN_MM, "--jobs", "0"]),
    "completion": ("completion", ["completion", "bash"]),
    "schema": ("schema", ["schema", "measure"]),
}  # fmt: skip


@pytest.mark.parametrize("call", CALLS)
def test_a_result_is_as_its_schema_says(capsys, scans, tmp_path, monkeypatch, call):
    monkeypatch.chdir(scans)
    name, arguments = CALLS[call]
    result = printed(capsys, *(argument.replace("OUT", str(tmp_path)) for argument in arguments))
    jsonschema.validate(result, read_schema(name))
    assert next(iter(result)) == "schema"
    assert result["schema"] == f"{name}/{VERSIONS[name]}"


def test_a_networks_sizes_are_as_their_schema_says():
    """What `classify` returns, whose network takes long to train."""
    result = {
        "schema": "classify/1", "file": "a.ply", "network": "run", "model": "adgcnn", "test_accuracy": 0.9,
        "size_mm2": "240", "probabilities": {"240": 0.9, "300": 0.1}, "measured_diameter_mm": 34.2,
    }  # fmt: skip
    jsonschema.validate(result, read_schema("classify"))


def test_what_lay_on_the_page_is_as_its_schema_says():
    """What `app` returns when it is ended."""
    cable = {"number": 1, "diameter_mm": 20.0, "interval_mm": [19.9, 20.1]}
    scans = [{"file": "a.ply", "error": None, "cables": [cable]}, {"file": "b.ply", "error": "is empty", "cables": []}]
    jsonschema.validate({"schema": "app/1", "url": "http://127.0.0.1:1/x/", "scans": scans}, read_schema("app"))


def test_every_command_has_a_schema_and_every_schema_a_version():
    assert set(COMMANDS) - {"report"} <= set(VERSIONS)
    assert {path.stem for path in FOLDER.glob("*.json")} == set(VERSIONS)
    for name in VERSIONS:
        jsonschema.Draft202012Validator.check_schema(read_schema(name))


@pytest.mark.parametrize("name", VERSIONS)
def test_a_field_more_or_less_is_a_fault(name):
    schema = read_schema(name)
    assert schema["additionalProperties"] is False
    assert set(schema["required"]) == set(schema["properties"])
    assert schema["properties"]["schema"]["const"] == f"{name}/{VERSIONS[name]}"


def test_cables_seen_all_round_fill_what_others_leave_empty(capsys, scans):
    half, round_ = (printed(capsys, "measure", str(scans / name), *IN_MM) for name in ("half.ply", "round.ply"))
    assert half["section_sizes"] is None
    assert round_["section_sizes"] is not None
    assert round_["bend_interval_mm"] is not None
    assert np.isfinite(round_["readings"]["mean_mm"])


@pytest.mark.parametrize("name", ["measure", "measure-all"])
def test_the_schema_lists_the_sources_of_the_budget(name):
    text = json.dumps(read_schema(name))
    sources = [value for key, value in vars(budget).items() if key.isupper() and isinstance(value, str)]
    assert len(sources) == 13
    assert json.dumps(sources) in text
