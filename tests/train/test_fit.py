"""The loop: learns, resumes bit for bit after SIGKILL, stops at NaN, gradient descent on the whole set."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.train import TrainingDiverged, cross_entropy, evaluate, fit
from cablejax.train.batches import epoch_rows, make_plan
from cablejax.train.engine import Engine, _program
from cablejax.train.metrics import class_average_accuracy, confusion_matrix, overall_accuracy
from cablejax.train.update import Compiled, make_runner
from tests.train.tiny import Tiny, settings, split, weights

ROOT = Path(__file__).resolve().parents[2]


def test_learns_and_leaves_the_given_model_alone():
    model = Tiny(nnx.Rngs(0))
    before = [np.array(leaf) for leaf in jax.tree.leaves(nnx.state(model, nnx.Param))]
    result = fit(model, split(), split(seed=1), settings(epochs=40), progress=False)
    assert result.history[-1].validation_overall > 0.8
    assert result.history[-1].train_loss < result.history[0].train_loss
    for old, now in zip(before, jax.tree.leaves(nnx.state(model, nnx.Param)), strict=True):
        np.testing.assert_array_equal(old, now)
    metrics = evaluate(result.model, split(seed=1), batch_size=5)
    assert metrics.overall == pytest.approx(result.history[-1].validation_overall)
    assert metrics.loss == pytest.approx(result.history[-1].validation_loss, rel=1e-5)


def test_curves_as_csv(tmp_path):
    """Every epoch is a row; without validation its columns are empty."""
    fit(Tiny(nnx.Rngs(0)), split(), split(seed=1), settings(epochs=2), folder=tmp_path / "a", progress=False)
    result = fit(Tiny(nnx.Rngs(0)), split(), None, settings(epochs=3), folder=tmp_path / "b", progress=False)
    with (tmp_path / "a" / "curves.csv").open(newline="") as file:
        assert [(row["epoch"], row["validation_overall"] != "") for row in csv.DictReader(file)] == [
            ("1", True),
            ("2", True),
        ]
    with (tmp_path / "b" / "curves.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["train_loss"]) for row in rows] == [epoch.train_loss for epoch in result.history]
    assert {row["validation_loss"] for row in rows} == {""}
    assert all(len(epoch.losses) == 3 for epoch in result.history)  # 24 clouds in batches of 8
    assert "losses" not in rows[0]


def test_running_statistics_move():
    result = fit(Tiny(nnx.Rngs(0)), split(), None, settings(epochs=1), progress=False)
    assert float(jnp.abs(result.model.norm.mean[...]).max()) > 0


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"ema_decay": 0.9, "keep_best": True, "schedule": "cosine"},
        {"optimizer": "schedule_free", "warmup_epochs": 1.0, "clip_norm": 1.0},
        {"optimizer": "muon"},
    ],
)
def test_resumed_equals_uninterrupted(tmp_path, changes):
    config = settings(**changes)
    whole = fit(Tiny(nnx.Rngs(0)), split(), split(seed=1), config, progress=False)

    class Stop(Exception):
        pass

    def cut(epoch):
        if epoch == 4:
            raise Stop
        return split()

    with pytest.raises(Stop):
        fit(Tiny(nnx.Rngs(0)), cut, split(seed=1), config, folder=tmp_path, progress=False)
    resumed = fit(Tiny(nnx.Rngs(7)), split(), split(seed=1), config, folder=tmp_path, progress=False)
    for a, b in zip(weights(whole), weights(resumed), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(whole.history, resumed.history, strict=True):
        assert a.scalars() | {"train/seconds": 0} == b.scalars() | {"train/seconds": 0}


def test_gives_up_what_has_not_begun_to_learn():
    run = [
        fit(Tiny(nnx.Rngs(0)), split(), None, settings(give_up_epoch=2, give_up_loss=loss), progress=False)
        for loss in (1e-6, 9.0)
    ]
    assert [len(each.history) for each in run] == [2, settings().epochs]


KILLS = int(os.environ.get("CABLEJAX_KILLS", "2"))  # 20 for the long form
EPOCHS = 60 * KILLS
CHILD = """
import sys
import numpy as np
from flax import nnx
from cablejax.train import fit
from tests.train.tiny import *
config = settings(epochs=int(sys.argv[3]))
result = fit(Tiny(nnx.Rngs(0)), split(), split(seed=1), config, folder=sys.argv[1], progress=False)
np.savez(sys.argv[2], *weights(result))
"""


def newest(folder):
    return max((path.name for path in folder.rglob("*.ckpt")), default="")


def test_killed_runs_end_bit_identical(tmp_path):
    command = [sys.executable, "-c", CHILD, str(tmp_path / "run"), str(tmp_path / "end.npz"), str(EPOCHS)]
    rng = np.random.default_rng(0)
    for _ in range(KILLS):
        before = newest(tmp_path)
        child = subprocess.Popen(command, cwd=ROOT, env=os.environ)
        while newest(tmp_path) == before and child.poll() is None:  # it has gone on from where the last one died
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.1))
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL, "the run ended before it could be killed"
    subprocess.run(command, cwd=ROOT, env=os.environ, check=True)
    whole = fit(Tiny(nnx.Rngs(0)), split(), split(seed=1), settings(epochs=EPOCHS), progress=False)
    with np.load(tmp_path / "end.npz") as end:
        for a, b in zip(weights(whole), end.values(), strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_folder_of_another_run_is_refused(tmp_path):
    fit(Tiny(nnx.Rngs(0)), split(), None, settings(epochs=1), folder=tmp_path, progress=False)
    with pytest.raises(ValueError, match=r"holds a run with learning_rate = 0.02, this one has 0.5"):
        fit(Tiny(nnx.Rngs(0)), split(), None, settings(epochs=1, learning_rate=0.5), folder=tmp_path, progress=False)
    with pytest.raises(ValueError, match="holds a run on other data"):
        fit(Tiny(nnx.Rngs(0)), split(seed=9), None, settings(epochs=1), folder=tmp_path, progress=False)


def test_nan_stops_with_step_batch_and_state(tmp_path):
    data = split()
    data.xyz[5] = np.nan
    with pytest.raises(TrainingDiverged, match=r"the loss is nan at step \d .*the state is in") as caught:
        fit(Tiny(nnx.Rngs(0)), data, None, settings(steps_per_dispatch=1), folder=tmp_path, progress=False)
    assert 5 in caught.value.details["rows"]
    assert list((tmp_path / "diverged").glob("*.ckpt"))


def test_sgd_takes_one_step_with_the_gradient_of_the_whole_set():
    class Linear(nnx.Module):
        def __init__(self):
            self.out = nnx.Linear(3, 3, rngs=nnx.Rngs(0))

        def __call__(self, xyz, mask):
            return self.out(jnp.mean(jnp.abs(xyz), axis=1))

    data, model = split(), Linear()
    graphdef, params = nnx.split(model)

    def loss(params):
        logits = nnx.merge(graphdef, params)(jnp.asarray(data.xyz), jnp.asarray(data.mask))
        return jnp.mean(cross_entropy(logits, jnp.asarray(data.label)))

    expected = jax.tree.map(lambda p, g: p - 0.3 * g, params, jax.grad(loss)(params))
    result = fit(model, data, None, settings(optimizer="sgd", learning_rate=0.3, epochs=1), progress=False)
    for a, b in zip(weights(result), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_precision_reaches_every_product(precision):
    config = settings(precision=precision)
    engine = Engine(Tiny(nnx.Rngs(0)), config, make_plan(24, config))
    state, data = engine.initial_state(), engine.put(split())
    run = make_runner(engine.graphdef, engine.optimizer, Compiled.of(config))
    text = (
        jax.jit(run)
        .lower(state, data, epoch_rows(config, 0, np.asarray(data[2]), engine.plan)[0], engine.schedule)
        .as_text()
    )
    products = [line for line in text.splitlines() if "dot_general" in line and "stablehlo" in line]
    assert len(products) >= 5  # two forward; for the kernels two more, for the hidden layer's output one
    assert all(("bf16" in line) == (precision == "bfloat16") for line in products)


@pytest.mark.parametrize(
    ("optimizer", "options", "others"),
    [
        ("adadelta", {"rho": 0.9}, {"rho": 0.5}),
        ("adagrad", {"initial_accumulator_value": 0.1}, {"initial_accumulator_value": 1.0}),
        ("mbgd", {"momentum": 0.5}, {"momentum": 0.9}),
        ("adamw", {"weight_decay": 0.01}, {"weight_decay": 10.0}),
        ("muon", {"beta": 0.8}, {"beta": 0.95}),
        ("schedule_free", {"b1": 0.8}, {"b1": 0.95}),
    ],
)
def test_one_program_for_all_rates_options_and_seeds(optimizer, options, others):
    """A run that takes another's program ends where it would have ended with one of its own."""

    def run(options, seed):
        config = settings(optimizer=optimizer, optimizer_options=options, learning_rate=0.1 + seed, seed=seed, epochs=2)
        return weights(fit(Tiny(nnx.Rngs(seed)), split(), None, config, progress=False))

    _program.cache_clear()
    first = run(options, 0)
    second = run(others, 1)
    assert _program.cache_info().misses == 1
    _program.cache_clear()
    for shared, own in zip(second, run(others, 1), strict=True):
        np.testing.assert_allclose(shared, own, rtol=1e-6, atol=1e-7)
    assert not any(np.allclose(a, b) for a, b in zip(first, second, strict=True) if a.ndim == 2)


def test_early_stopping_returns_the_best_epoch():
    config = settings(epochs=50, patience=2, keep_best=True, learning_rate=1e-6)
    result = fit(Tiny(nnx.Rngs(0)), split(), split(seed=1), config, progress=False)
    assert len(result.history) < 50
    assert evaluate(result.model, split(seed=1)).overall == result.history[result.best_epoch - 1].validation_overall


def test_metrics_of_equations_20_and_21():
    confusion = confusion_matrix(np.array([0, 0, 0, 1]), np.array([0, 0, 1, 1]), 3)
    assert overall_accuracy(confusion) == 0.75
    assert class_average_accuracy(confusion) == pytest.approx((2 / 3 + 1) / 2)


def test_cross_entropy_equals_numpy():
    rng = np.random.default_rng(0)
    logits, labels = rng.normal(size=(5, 4)), rng.integers(0, 4, 5)
    log_p = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    target = 0.9 * np.eye(4)[labels] + 0.1 / 4
    found = cross_entropy(jnp.asarray(logits, jnp.float32), jnp.asarray(labels), label_smoothing=0.1)
    np.testing.assert_allclose(found, -(target * log_p).sum(axis=1), rtol=1e-5)


@pytest.mark.parametrize(
    "change",
    [
        {"epochs": 0},
        {"optimizer": "x"},
        {"label_smoothing": 1.0},
        {"schedule": "step"},
        {"patience": 0},
        {"precision": "half"},
    ],
)
def test_settings_out_of_range_are_named(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        fit(Tiny(nnx.Rngs(0)), split(), None, settings(**change), progress=False)
