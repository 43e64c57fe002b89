"""The training loop: epochs, validation, best weights, resuming."""

import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx
from tqdm import tqdm

from cablejax.io.tensorboard import RunLogger
from cablejax.train.batches import make_plan
from cablejax.train.config import TrainConfig
from cablejax.train.engine import Engine, TrainingDiverged
from cablejax.train.history import EpochRecord, best_epoch, given_up, out_of_patience
from cablejax.train.metrics import Clouds
from cablejax.train.placement import Placement
from cablejax.train.resume import RunFolder, data_checksum
from cablejax.train.tensorboard_views import log_attention, log_clouds
from cablejax.train.update import TrainState

TrainData = Clouds | Callable[[int], Clouds]


class TrainResult(NamedTuple):
    """A finished run.

    Attributes:
        model: The trained model, in evaluation mode.
        history: One record an epoch.
        best_epoch: See `cablejax.train.history.best_epoch`.
        compile_seconds: Spent on compiling the training step in this process.
        seconds: Training time of all epochs, over restarts.
    """

    model: nnx.Module
    history: list[EpochRecord]
    best_epoch: int
    compile_seconds: float
    seconds: float


def fit(
    model: nnx.Module,
    train: TrainData,
    validation: Clouds | None,
    config: TrainConfig,
    *,
    folder: str | os.PathLike[str] | None = None,
    logger: RunLogger | None = None,
    progress: bool = True,
    devices: Sequence[jax.Device] | None = None,  # pyright: ignore[reportInvalidTypeForm]
) -> TrainResult:
    """Train a model; the one given is not changed.

    The same call on the same machine gives the same bits, whether or not the process was killed on the way: with
    `folder`, the state is saved after every epoch, and a restart repeats at most the epoch that was cut off.

    Args:
        model: Called as `(xyz [b, n, 3], mask [b, n]) -> logits`.
        train: Labelled clouds, or a function that gives an epoch's clouds from its number (0, 1, ...): the same number
            must give the same clouds, and all epochs the same shapes.
        validation: Clouds that choose the best epoch; None trains without.
        config: Settings.
        folder: The run's own; None keeps nothing.
        logger: Where curves go.
        progress: Show a progress bar where the output is a terminal.
        devices: Each batch is cut over these; None takes all there are, those of other processes included.

    Returns:
        The trained model and its history.

    Raises:
        ValueError: If a setting is out of range, a split is empty, a batch cannot be cut over the devices, or `folder`
            holds another run.
        TrainingDiverged: If a loss is not finite; it names step and batch and, with `folder`, where the state lies.
    """
    config.validate()
    first = train(0) if callable(train) else train
    plan = make_plan(len(first.label), config, model)
    engine = Engine(model, config, plan, Placement(devices))
    run = None if folder is None else RunFolder(folder, config, data_checksum(first, validation, also=engine.also))
    state, best, history = _start(engine, run)
    data = engine.put(first)
    if logger is not None:
        log_clouds(logger, "train/clouds", first, 0)
    bar = tqdm(
        total=config.epochs * plan.batches,
        initial=len(history) * plan.batches,
        desc=config.optimizer,
        unit="step",
        disable=None if progress else True,
        dynamic_ncols=True,
    )
    with bar:
        for epoch in range(len(history), config.epochs):
            if out_of_patience(history, config.patience):
                break
            if given_up(history, config.give_up_epoch, config.give_up_loss):
                break
            if callable(train) and epoch > 0:
                data = engine.put(train(epoch))
            try:
                state, record = engine.train_epoch(state, data, epoch, on_batches=bar.update)
            except TrainingDiverged as error:
                raise _kept(error, run, engine.placement) from None
            if validation is not None:
                record = record.with_validation(engine.evaluate(state, validation))
                if logger is not None:
                    log_attention(logger, engine.eval_graphdef, engine.merged(state), validation, record.epoch)
            history.append(record)
            if config.keep_best and best_epoch(history) == record.epoch:
                best = jax.tree.map(jnp.copy, engine.weights(state))
            tree = engine.placement.local((state, best))
            _report(record, history, tree, run if engine.placement.writes else None, logger, bar)

    trained = engine.model(best if config.keep_best else engine.weights(state))
    seconds = sum(each.seconds for each in history)
    return TrainResult(trained, history, best_epoch(history), engine.compile_seconds, seconds)


def _start(engine: Engine, run: RunFolder | None) -> tuple[TrainState, Any, list[EpochRecord]]:
    """State, best weights and history to begin with: the folder's, or fresh ones."""
    state = engine.initial_state()
    best = jax.tree.map(jnp.copy, engine.weights(state)) if engine.config.keep_best else None
    engine.placement.meet()  # a checkpoint that one process reads and another does not yet see would part them for good
    found = None if run is None else run.load(engine.placement.local((state, best)))
    if found is None:
        return state, best, []
    (state, best), history = engine.placement.replicate(found[0]), found[1]
    return state, best, [EpochRecord(**each) for each in history]


def _kept(error: TrainingDiverged, run: RunFolder | None, placement: Placement) -> TrainingDiverged:
    """The error, with the state written beside the checkpoints and the place named."""
    if run is None or not placement.writes:
        return error
    path = run.save_diverged(error.details["step"], placement.local(error.state), error.details)
    return TrainingDiverged(f"{error}; the state is in {path}", error.state, error.details)


def _report(
    record: EpochRecord,
    history: list[EpochRecord],
    tree: Any,
    run: RunFolder | None,
    logger: RunLogger | None,
    bar: tqdm,
) -> None:
    """Save, log and show an epoch."""
    if run is not None:
        run.save(record.epoch, tree, [dataclasses.asdict(each) for each in history])
    if logger is not None:
        logger.scalars(record.scalars(), record.epoch)
    shown = {"loss": f"{record.train_loss:.3f}"}
    if record.validation_overall is not None:
        shown["val"] = f"{record.validation_overall:.3f}"
    bar.set_postfix(shown)
