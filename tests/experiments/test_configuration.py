"""Every experiment composes; whatever is wrong is said in one line."""

import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from experiments import ROOT, app, schema
from experiments.app import to_config

CONF = ROOT / "conf"
GROUPS = ("filter", "noise", "scan", "dataset", "model", "optimizer", "launcher", "size", "experiment")
SHARED = {"networks"}  # what several experiments start from, none itself
EXPERIMENTS = sorted({path.stem for path in (CONF / "experiment").glob("*.yaml")} - SHARED)


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
        ("nonsense=1", ["nonsense"]),
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
    for word in words:
        assert word in lines[0]
    assert not list(tmp_path.rglob("run.json"))


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
