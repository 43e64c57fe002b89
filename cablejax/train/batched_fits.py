"""Several runs of one architecture trained together: seeds and learning rates as one more axis of every array."""

import dataclasses
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from tqdm import tqdm

from cablejax.train.batches import epoch_rows, make_plan
from cablejax.train.config import TrainConfig
from cablejax.train.engine import Engine
from cablejax.train.fitting import TrainResult
from cablejax.train.history import EpochRecord, best_epoch
from cablejax.train.metrics import Clouds
from cablejax.train.update import Compiled, Schedule, StepReport, TrainState, make_runner, rate_at


def fit_together(
    models: Sequence[nnx.Module],
    train: Clouds,
    validation: Clouds | None,
    config: TrainConfig,
    *,
    seeds: Sequence[int] | None = None,
    learning_rates: Sequence[float] | None = None,
    progress: bool = True,
) -> list[TrainResult]:
    """Train models of one architecture side by side in one compiled call, each as `fit` would train it alone.

    It pays on a device that one run does not fill, and for many short runs, which share one compilation. Nothing is
    written: a sweep that must survive a kill runs `fit` with a folder for each. A run whose loss is no longer finite goes on
    among the others and ends with NaN in its history.

    Args:
        models: m models of one architecture, with initial weights of their own.
        train: Labelled clouds, the same for all.
        validation: Clouds that choose each run's best epoch; None trains without.
        config: Settings of all; `patience` and `give_up_epoch` are not looked at.
        seeds: Order of the clouds in each run `[m]`; None takes `config.seed` for all.
        learning_rates: Rate of each run `[m]`; None takes `config.learning_rate` for all.
        progress: Show a progress bar where the output is a terminal.

    Returns:
        One result a model; times are not told apart and left at 0.

    Raises:
        ValueError: If lengths differ, or a model is of another architecture.
    """
    configs = _configs(config, len(models), seeds, learning_rates)
    plan = make_plan(len(train.label), config, models[0])
    engines = [Engine(model, each, plan) for model, each in zip(models, configs, strict=True)]
    first = engines[0]
    if any(engine.graphdef != first.graphdef for engine in engines[1:]):
        raise ValueError("models: expected one architecture, with the same options, for all")
    states = [engine.initial_state() for engine in engines]
    best = [engine.weights(state) for engine, state in zip(engines, states, strict=True)]
    histories: list[list[EpochRecord]] = [[] for _ in engines]
    state, data = _stacked(states), first.put(train)
    stacked = [np.stack(each) for each in zip(*(engine.schedule for engine in engines), strict=True)]
    schedule = Schedule(*stacked)  # pyright: ignore[reportArgumentType]
    run = _compiled(first)
    for epoch in tqdm(
        range(config.epochs), desc=f"{len(models)} x {config.optimizer}", disable=None if progress else True
    ):
        rows = jnp.stack([epoch_rows(each, epoch, np.asarray(train.label), plan) for each in configs])
        reports = []
        for call in range(rows.shape[1]):
            state, report = run(state, data, rows[:, call], schedule)
            reports.append(jax.device_get(report))
        parts = [np.concatenate(each, axis=1) for each in zip(*reports, strict=True)]
        joined = StepReport(*parts)  # pyright: ignore[reportArgumentType]
        for member, engine in enumerate(engines):
            own = jax.tree.map(lambda leaf, member=member: leaf[member], state)
            histories[member].append(_record(engine, own, joined, member, epoch, validation))
            if not config.keep_best or best_epoch(histories[member]) == epoch + 1:
                best[member] = engine.weights(own)
    return [
        TrainResult(engine.model(weights), history, best_epoch(history), 0.0, 0.0)
        for engine, weights, history in zip(engines, best, histories, strict=True)
    ]


def _configs(
    config: TrainConfig, count: int, seeds: Sequence[int] | None, rates: Sequence[float] | None
) -> list[TrainConfig]:
    """The settings of each run, valid."""
    chosen = {"seed": seeds, "learning_rate": rates}
    for name, values in chosen.items():
        if values is not None and len(values) != count:
            raise ValueError(f"{name}: expected {count} values, one a model, got {len(values)}")
    changes = {name: values for name, values in chosen.items() if values is not None}
    configs = [
        dataclasses.replace(config, **{name: values[member] for name, values in changes.items()})
        for member in range(count)
    ]
    if not configs:
        raise ValueError("models: expected at least one, got none")
    for each in configs:
        each.validate()
    return configs


def _stacked(trees: Sequence[TrainState]) -> TrainState:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _compiled(engine: Engine) -> Callable[..., tuple[TrainState, StepReport]]:
    function = make_runner(engine.graphdef, engine.optimizer, Compiled.of(engine.config))
    return jax.jit(jax.vmap(function, in_axes=(0, None, 0, 0)), donate_argnums=0)


def _record(
    engine: Engine, state: TrainState, reports: StepReport, member: int, epoch: int, validation: Clouds | None
) -> EpochRecord:
    """What an epoch did to one run; its time is not told apart from the others'."""
    clouds = engine.plan.batches * engine.plan.batch_size
    rate = rate_at(state.step - 1, engine.schedule, kind=engine.config.schedule)
    record = EpochRecord(
        epoch=epoch + 1,
        train_loss=float(reports.loss[member].mean(dtype=np.float64)),
        train_overall=float(reports.correct[member].sum() / clouds),
        validation_loss=None,
        validation_overall=None,
        validation_class_average=None,
        learning_rate=float(rate),
        grad_norm=float(reports.grad_norm[member].mean(dtype=np.float64)),
        seconds=0.0,
        losses=reports.loss[member].tolist(),
    )
    return record if validation is None else record.with_validation(engine.evaluate(state, validation))
