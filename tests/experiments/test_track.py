"""Runs that are sent to Weights & Biases: what is sent, once a configuration and revision. The service is stood in for."""

import sys
from types import SimpleNamespace

import pytest

from cablejax.io import write_json
from experiments import track


class Service:
    """Keeps what `wandb.init` and the run that it gives are handed."""

    def __init__(self):
        self.runs = []

    def init(self, **given):
        run = SimpleNamespace(given=given, rows={}, summary={}, finished=False)
        run.log = lambda row, step: run.rows.update({step: row})
        run.finish = lambda: setattr(run, "finished", True)
        self.runs.append(run)
        return run


@pytest.fixture
def service(monkeypatch):
    made = Service()
    monkeypatch.setitem(sys.modules, "wandb", made)
    monkeypatch.setattr(track, "require", lambda *packages, why: None)
    return made


@pytest.fixture
def sweep(tmp_path):
    """Two finished runs, one with curves, and one that was killed."""
    for seed in range(3):
        folder = tmp_path / "fig13_optimizers" / "quick" / f"seed={seed}-{seed:012x}"
        folder.mkdir(parents=True)
        record = {"experiment": "fig13_optimizers", "code_revision": "0123456789abcdef+", "seconds": 2.5, "seed": seed}
        metrics = {"test": {"overall": 0.5}, "history": {"loss": [2.0, 1.0]}, "diverged": False}
        if seed < 2:
            write_json(folder / "run.json", {**record, "config": {"optimizer": {"name": "adam"}}, "metrics": metrics})
    (folder.parent / f"seed=0-{0:012x}" / "curves.csv").write_text(
        "epoch,train_loss,validation_loss\n1,2.0,\n2,1.0,1.5\n"
    )
    return tmp_path


def run_main(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["track", *map(str, arguments)])
    return track.main()


def test_finished_runs_are_sent_with_curves_and_numbers(service, sweep, monkeypatch):
    assert run_main(monkeypatch, sweep, "--project", "cables") == 0
    first, second = service.runs
    assert first.given["project"] == "cables"
    assert first.given["name"] == "seed=0"
    assert first.given["config"] == {"optimizer.name": "adam", "code_revision": "0123456789abcdef+"}
    assert first.rows == {
        1: {"epoch": 1.0, "train_loss": 2.0},
        2: {"epoch": 2.0, "train_loss": 1.0, "validation_loss": 1.5},
    }
    assert first.summary == {"test.overall": 0.5, "seconds": 2.5}
    assert second.rows == {}
    assert all(run.finished for run in service.runs)


def test_a_run_has_the_same_id_each_time_and_another_at_another_revision(service, sweep, monkeypatch):
    folder = sweep / "fig13_optimizers" / "quick" / f"seed=0-{0:012x}"
    for revision in ("0123456789abcdef", "0123456789abcdef", "fedcba9876543210"):
        record = {"experiment": "e", "code_revision": revision, "seconds": 1.0, "config": {}, "metrics": {}}
        write_json(folder / "run.json", record)
        run_main(monkeypatch, folder)
    ids = [run.given["id"] for run in service.runs]
    assert ids[0] == ids[1] != ids[2]
    assert all(run.given["resume"] == "allow" for run in service.runs)


@pytest.mark.parametrize("name", ["missing", "."])
def test_a_folder_without_runs_is_told(service, tmp_path, monkeypatch, capsys, name):
    assert run_main(monkeypatch, tmp_path / name) == 2
    assert "expected finished runs in" in capsys.readouterr().err
