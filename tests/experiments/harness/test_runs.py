"""A run is done once per code revision and configuration, and results are folded from complete sets alone."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cablejax.io import read_json
from experiments import collect
from experiments.harness import revision, runs, schema
from tests.experiments.harness.test_configuration import compose_config


@pytest.fixture
def config(tmp_path: Path) -> schema.Config:
    return compose_config("experiment=table1_filtering", f"out={tmp_path / 'runs'}")


def task(cfg: schema.Config, folder: Path) -> dict[str, float]:
    with (folder / "calls.txt").open("a") as file:
        file.write("called\n")
    return {"value": 10.0 * cfg.seed + cfg.filter.k}


def calls(folder: Path) -> int:
    return len((folder / "calls.txt").read_text().splitlines())


def test_a_finished_run_is_not_run_again(config: schema.Config):
    first, there = runs.execute(task, config, label="seed=0")
    assert not there
    again, there = runs.execute(task, config, label="another label")
    assert there
    assert again == json.loads(json.dumps(first))
    assert calls(runs.run_folder(config)) == 1


def test_record_tells_where_its_numbers_come_from(config: schema.Config):
    record, _ = runs.execute(task, config)
    assert record["seed"] == 0
    assert record["provenance"]["seeds"] == [0]
    assert record["code_revision"] == revision.code_revision()
    assert record["config"]["filter"]["k"] == config.filter.k
    assert "out" not in record["config"]


def test_other_code_runs_again_from_an_empty_folder(config: schema.Config, monkeypatch: pytest.MonkeyPatch):
    runs.execute(task, config)
    monkeypatch.setattr(runs, "code_revision", lambda: "another")
    record, there = runs.execute(task, config)
    assert not there
    assert record["code_revision"] == "another"
    assert calls(runs.run_folder(config)) == 1


def test_a_killed_run_goes_on_in_its_folder(config: schema.Config):
    def killed(cfg: schema.Config, folder: Path) -> dict[str, float]:
        (folder / "checkpoint").write_text("half-way")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runs.execute(killed, config)
    assert not (runs.run_folder(config) / runs.RECORD).exists()
    runs.execute(task, config)
    assert (runs.run_folder(config) / "checkpoint").read_text() == "half-way"


BROKEN = pytest.mark.parametrize("content", ["", "{", "null", "{}"])  # what a full disk, or a hand, leaves


@BROKEN
def test_a_broken_record_is_made_anew_and_kept_beside(config: schema.Config, content: str):
    runs.execute(task, config)
    folder = runs.run_folder(config)
    for i in range(2):
        (folder / runs.RECORD).write_text(content)
        record, there = runs.execute(task, config)
        assert not there
        assert read_json(folder / runs.RECORD) == json.loads(json.dumps(record))
        assert calls(folder) == i + 2  # the same folder, so that training goes on from its last checkpoint
    kept = sorted(path.name for path in folder.glob("run.json.broken*"))
    assert kept == ["run.json.broken", "run.json.broken2"]
    assert {(folder / name).read_text() for name in kept} == {content}


@BROKEN
def test_a_folder_of_which_nothing_is_known_is_kept_beside(config: schema.Config, content: str):
    folder = runs.run_folder(config)
    folder.mkdir(parents=True)
    (folder / runs.BEGUN).write_text(content)
    (folder / "checkpoint").write_text("of unknown code")
    _, there = runs.execute(task, config)
    assert not there
    assert not (folder / "checkpoint").exists()
    assert (folder.with_name(f"{folder.name}.broken") / "checkpoint").read_text() == "of unknown code"
    assert runs.execute(task, config)[1]  # the kept folder is not taken for the run's


def test_collect_names_a_broken_record(config: schema.Config):
    runs.execute(task, config)
    (runs.run_folder(config) / runs.RECORD).write_text("")
    with pytest.raises(collect.CollectError, match=r"run\.json: no record"):
        fold(config)


def test_configurations_do_not_share_folders(config: schema.Config):
    other = replace(config, filter=replace(config.filter, k=21))
    assert runs.run_folder(config) != runs.run_folder(other)


def sweep(config: schema.Config, *, ks: tuple[int, ...], seeds: tuple[int, ...]) -> Path:
    for k in ks:
        for seed in seeds:
            runs.execute(task, replace(config, seed=seed, filter=replace(config.filter, k=k)))
    return Path(config.out)


def fold(config: schema.Config, *, allow_dirty: bool = True, revision: str | None = None) -> Path:
    out = Path(config.out).parent / "results"
    runs_folder = Path(config.out)
    return collect.collect(
        config.name, size="quick", runs=runs_folder, out=out, revision=revision, allow_dirty=allow_dirty
    )


def test_collect_keeps_every_run_and_names_only_what_differs(config: schema.Config):
    sweep(config, ks=(10, 20), seeds=(0, 1))
    result = read_json(fold(config))
    assert result["seeds"] == [0, 1]
    assert [(row["cell"], row["seed"], row["metrics"]["value"]) for row in result["runs"]] == [
        ({"filter.k": 10}, 0, 10.0),
        ({"filter.k": 10}, 1, 20.0),
        ({"filter.k": 20}, 0, 20.0),
        ({"filter.k": 20}, 1, 30.0),
    ]
    assert result["config"]["scan.n_points"] == 53_135
    assert "filter.k" not in result["config"]


def test_every_run_of_a_results_file_can_be_composed_again(config: schema.Config):
    """A key that only one filter has, None there, once stood among what all runs share, and verify broke on the others."""
    for name in ("adaptive", "median"):
        cfg = replace(compose_config("experiment=table1_filtering", f"filter={name}"), out=config.out)
        runs.execute(task, cfg)
    result = read_json(fold(config))
    assert "filter.smooth_k" not in result["config"]
    for row in result["runs"]:
        again = schema.from_flat({**result["config"], **row["cell"], "seed": row["seed"], "out": config.out})
        assert again.filter.name == row["cell"]["filter.name"]
    # Files collected before that was mended hold the key.
    old = {**result["config"], **result["runs"][1]["cell"], "filter.smooth_k": None, "seed": 0, "out": config.out}
    assert schema.from_flat(old).filter.name == "median"


def test_collect_refuses_missing_seeds(config: schema.Config):
    sweep(config, ks=(10, 20), seeds=(0, 1))
    sweep(config, ks=(10,), seeds=(2,))
    with pytest.raises(collect.CollectError, match=r"missing seeds: .*20.* lacks seed 2"):
        fold(config)


def test_collect_refuses_mixed_revisions(config: schema.Config, monkeypatch: pytest.MonkeyPatch):
    sweep(config, ks=(10,), seeds=(0,))
    monkeypatch.setattr(runs, "code_revision", lambda: "another")
    sweep(config, ks=(20,), seeds=(0,))
    with pytest.raises(collect.CollectError, match="mixed revisions"):
        fold(config)
    assert [row["cell"] for row in read_json(fold(config, revision="another"))["runs"]] == [{}]


def test_collect_refuses_uncommitted_code(config: schema.Config, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(runs, "code_revision", lambda: "abc+changed")
    sweep(config, ks=(10,), seeds=(0,))
    with pytest.raises(collect.CollectError, match="uncommitted code"):
        fold(config, allow_dirty=False)


def test_collect_refuses_an_empty_folder(config: schema.Config):
    with pytest.raises(collect.CollectError, match="no finished run"):
        fold(config)
