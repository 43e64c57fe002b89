"""The notebooks run from results/ alone, are committed with their output, and train nothing."""

import json
import shutil
from pathlib import Path

import pytest
from nbclient.exceptions import CellExecutionError

from experiments import ROOT
from experiments.notebooks import execute

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path):
    text = execute(path)
    assert "image/png" in text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_committed_with_its_output(path: Path):
    cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in cells), f"{path.name}: run `make notebooks`"
    for cell in cells:
        assert "cablejax.train" not in "".join(cell["source"])


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout in a folder with blanks."""
    root = tmp_path_factory.mktemp("my files") / "a copy"
    for name in ("cablejax", "experiments", "conf", "notebooks"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    (root / "results").mkdir()
    for path in (ROOT / "results").glob("optimizer_*.json"):
        shutil.copy(path, root / "results")
    return root


@pytest.mark.parametrize("opened_from", [".", "notebooks"])
def test_notebook_runs_from_anywhere_in_a_checkout(copy: Path, opened_from: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    text = execute(copy / "notebooks" / "03_optimizers.ipynb", folder=copy / opened_from)
    assert "image/png" in text
    assert "make fig13_optimizers" in text  # the copy lacks that file, so it was the copy's results that were read


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_finds_its_checkout_first(path: Path):
    first = [
        next(cell["source"] for cell in json.loads(each.read_text())["cells"] if cell["cell_type"] == "code")
        for each in (path, NOTEBOOKS[0])
    ]
    assert first[0] == first[1]
    assert "make lab" in "".join(first[0])


def test_without_a_checkout_a_notebook_says_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    with pytest.raises(CellExecutionError, match=r"SystemExit.*results/ of a checkout of cablejax.*make lab"):
        execute(NOTEBOOKS[0], folder=tmp_path)
