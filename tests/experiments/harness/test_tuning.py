"""Learning rates of the optimizer study: the same budget for each, the best on validation, nothing of the test split."""

import itertools
from pathlib import Path

import pytest

from cablejax.io import write_json
from experiments.harness import tuning
from tests.experiments.harness.test_configuration import compose_config

OPTIMIZERS = ("adadelta", "sgd", "mbgd", "adagrad", "rmsprop", "adam", "adamw")


def search(accuracies: dict[str, dict[float, float]]) -> dict:
    return {
        "runs": [
            {"cell": {"optimizer.name": name}, "metrics": {"learning_rate": rate, "validation_overall": accuracy}}
            for name, rates in accuracies.items()
            for rate, accuracy in rates.items()
        ]
    }


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_every_optimizer_is_tuned_over_four_decades(optimizer: str):
    config = compose_config("experiment=optimizer_search", f"optimizer={optimizer}").optimizer
    assert config.highest_rate / config.lowest_rate == pytest.approx(1e4)
    assert config.lowest_rate <= config.keras_rate < config.highest_rate or optimizer == "adadelta"


def test_trials_fill_the_range_evenly():
    # Seven terms of the van der Corput sequence cut an interval into eighths.
    rates = sorted(tuning.trial_rate(1e-4, 1.0, trial) for trial in range(7))
    ratios = [b / a for a, b in itertools.pairwise(rates)]
    assert ratios == pytest.approx([10**0.5] * 6, rel=1e-3)


def test_search_composes_the_trials_rate_and_leaves_the_test_split_alone():
    config = compose_config("experiment=optimizer_search", "optimizer=adam", "trial=2")
    assert config.optimizer.learning_rate == tuning.trial_rate(1e-4, 1.0, 2)
    assert config.rates == "trial"
    assert not config.training.test


def test_tuned_rate_is_the_best_on_validation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tuning, "ROOT", tmp_path)
    with pytest.raises(ValueError, match="make optimizer_search"):
        tuning.tuned_rate("adam")
    (tmp_path / "results").mkdir()
    found = {"adam": {1e-4: 0.5, 1e-3: 0.8, 1e-2: 0.8, 1e-1: 0.0}}
    write_json(tmp_path / "results" / "optimizer_search.json", search(found))
    assert tuning.tuned_rate("adam") == 1e-2
    with pytest.raises(ValueError, match="expected one of adam, got lion"):
        tuning.tuned_rate("lion")
    config = compose_config("experiment=optimizer_study", "optimizer=adam", "rates=tuned")
    assert config.optimizer.learning_rate == 1e-2
    assert compose_config("experiment=optimizer_study", "rates=keras").optimizer.learning_rate == 0.001
