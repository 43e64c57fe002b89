"""Every experiment composes; whatever is wrong is said in one line."""

import sys
from dataclasses import fields
from functools import cache
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from cablejax.train import TrainConfig
from experiments import ROOT
from experiments.harness import app, schema
from experiments.harness.app import to_config
from experiments.material.training import training_config

CONF = ROOT / "conf"
GROUPS = ("filter", "noise", "scan", "dataset", "model", "optimizer", "launcher", "size", "experiment")
UNKNOWN = ("nonsense", *(f"{group}.nonsense" for group in (*schema.GROUPS, "filter")))
SHARED = {"networks"}  # what several experiments start from, none itself
EXPERIMENTS = sorted({path.stem for path in (CONF / "experiment").glob("*.yaml")} - SHARED)


@cache
def compose_config(*overrides: str) -> schema.Config:
    schema.register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return to_config(compose("config", overrides=list(overrides)))


@pytest.mark.parametrize("size", schema.SIZES)
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_experiment_composes(experiment: str, size: str):
    config = compose_config(f"experiment={experiment}", f"size={size}")
    assert config.size == size
    assert config.name


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_first_comment_tells_command_paper_and_time(experiment: str):
    comment = [
        line for line in (CONF / "experiment" / f"{experiment}.yaml").read_text().splitlines() if line[:1] == "#"
    ]
    for word in ("# Command: python -m experiments.", "# Paper", "# Takes: "):
        assert any(line.startswith(word) for line in comment), f"{experiment}: no {word!r}"


@pytest.mark.parametrize(
    ("group", "option"),
    [(group, path.stem) for group in GROUPS[:6] for path in sorted((CONF / group).glob("*.yaml"))],
)
def test_every_option_composes(group: str, option: str):
    assert compose_config("experiment=train", f"{group}={option}")


def test_figures_9_to_12_share_the_runs_of_5_to_8():
    for accuracy, loss in (("fig5_alexnet", "fig9_alexnet_loss"), ("fig8_adgcnn", "fig12_adgcnn_loss")):
        assert compose_config(f"experiment={accuracy}") == compose_config(f"experiment={loss}")


def test_a_dictconfig_goes_no_further_than_to_config():
    config = compose_config("experiment=train")
    assert not OmegaConf.is_config(config.model.options)
    assert not OmegaConf.is_config(config.dataset.sizes_mm2)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("filter.kk=3", ["filter.kk"]),
        ("filter=butterworth", ["filter/butterworth", "adaptive", "statistical"]),
        ("nonsense=1", ["nonsense", "There are"]),
        ("foo/bar=1", ["foo/bar"]),
        ("training.epoch=1", ["training.epoch: unknown key; did you mean epochs?"]),
        *((f"{plus}{key}=7", [f"{key}: unknown key"]) for plus in ("+", "++") for key in UNKNOWN),
        ("~training", ["training", "taken away"]),
        ("~filter", ["filter", "taken away"]),
        ("training.log_every=1", ["training.log_every: unknown key"]),
        ("training.clip_norm=0", ["training.clip_norm", "positive", "0"]),
        ("training.warmup_epochs=-1", ["training.warmup_epochs", "-1"]),
        ("training.patience=0", ["training.patience", "at least 1"]),
        ("sweeper=optuna", ["sweeper=optuna", "objective"]),
        ("hydra/sweeper=optuna", ["hydra/sweeper=optuna", "objective"]),
        ("filter.k=many", ["many", "Integer"]),
        ("filter.k=0", ["filter.k", "between 1 and 128", "0"]),
        ("noise.kind=loud", ["noise.kind", "gaussian", "loud"]),
        ("dataset.version=easy", ["dataset.version", "standard", "easy"]),
        ("optimizer.learning_rate=-1", ["optimizer.learning_rate", "positive", "-1"]),
        ("size=huge", ["size/huge", "quick"]),
        ("seed=-1", ["seed", "-1"]),
    ],
)
def test_a_wrong_override_gives_one_clear_line(
    override: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    def never(cfg: schema.Config, folder: Path) -> dict[str, float]:
        raise AssertionError("the task must not run")

    monkeypatch.setattr(sys, "argv", ["table1_filtering", override, f"out={tmp_path}"])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    with pytest.raises(SystemExit) as stopped:
        app.main(never, experiment="table1_filtering", headline=str)
    assert stopped.value.code == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert "+" not in lines[0].split(" [")[0]  # no advice to add what nothing reads
    for word in words:
        assert word in lines[0]
    assert not list(tmp_path.rglob("run.json"))


TRAIN_FIELDS = {
    "optimizer": ("optimizer=adam", "adam"),
    "learning_rate": ("optimizer.learning_rate=0.5", 0.5),
    "optimizer_options": ("+optimizer.options.rho=0.9", {"rho": 0.9}),
    "epochs": ("training.epochs=3", 3),
    "batch_size": ("training.batch_size=7", 7),
    "seed": ("seed=5", 5),
    "balanced": ("training.balanced=false", False),
    "schedule": ("training.schedule=constant", "constant"),
    "warmup_epochs": ("training.warmup_epochs=1.5", 1.5),
    "label_smoothing": ("training.label_smoothing=0.1", 0.1),
    "clip_norm": ("training.clip_norm=1", 1.0),
    "ema_decay": ("training.ema_decay=0.9", 0.9),
    "patience": ("training.patience=4", 4),
    "give_up_epoch": ("training.give_up_epoch=3", 3),
    "give_up_loss": ("training.give_up_loss=2.5", 2.5),
    "keep_best": ("training.keep_best=false", False),
    "frozen": ("training.frozen=[layers]", ("layers",)),
    "precision": ("training.precision=bfloat16", "bfloat16"),
    "steps_per_dispatch": ("training.steps_per_dispatch=3", 3),
    "eval_batch_size": ("training.eval_batch_size=5", 5),
}


@pytest.mark.parametrize("name", [each.name for each in fields(TrainConfig)])
def test_every_setting_of_the_training_loop_is_reached_from_the_command_line(name: str):
    override, value = TRAIN_FIELDS[name]
    before, after = (training_config(compose_config("experiment=train", *more)) for more in ((), (override,)))
    assert getattr(before, name) != value
    assert getattr(after, name) == value
    after.validate()


@pytest.mark.parametrize("sweep", [[], ["-m"]])
def test_a_place_that_cannot_be_written_is_a_sentence(
    sweep: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    place = tmp_path / "file"
    place.write_text("no folder")
    monkeypatch.setattr(sys, "argv", ["table1_filtering", *sweep, "seed=0", f"out={place}"])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    with pytest.raises(SystemExit) as stopped:
        app.main(lambda cfg, folder: {}, experiment="table1_filtering", headline=str)
    assert stopped.value.code == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert str(place) in lines[0]
    assert "Not a directory" in lines[0]


def test_a_sweep_goes_on_past_a_job_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(
        sys,
        "argv",
        ["table1_filtering", "-m", "noise=none", "filter=median", "filter.k=5,0,7", "seed=0", f"out={tmp_path}"],
    )
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    with pytest.raises(SystemExit) as stopped:
        app.main(lambda cfg, folder: {"k": cfg.filter.k}, experiment="table1_filtering", headline=str)
    assert stopped.value.code == 2
    captured = capfd.readouterr()
    assert "filter.k=0" in captured.err
    assert len(list(tmp_path.rglob("run.json"))) == 2
