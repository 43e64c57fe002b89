"""A model, an optimizer and settings made into epochs: compilation, dispatch, divergence."""

import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array

from cablejax.train.batches import Plan, epoch_rows
from cablejax.train.config import TrainConfig
from cablejax.train.history import EpochRecord
from cablejax.train.memory import release_freed_memory
from cablejax.train.metrics import Clouds, Metrics, also_learnt, arrays_of, predict, score_all
from cablejax.train.optimizers import (
    OPTIMIZERS,
    OptimizerKey,
    evaluation_params,
    make_optimizer,
    optimizer_key,
    optimizer_of,
)
from cablejax.train.placement import Placement
from cablejax.train.update import Compiled, Data, Schedule, StepReport, TrainState, make_runner, rate_at

PROGRAMS = 12  # kept: of a study's optimizers, one each


@lru_cache(maxsize=PROGRAMS)
def _program(graphdef: Any, optimizer: OptimizerKey, config: Compiled, everywhere: Any) -> tuple[Any, dict[Any, Any]]:
    """The training call to be compiled, and what it was compiled to, by shapes: one for all seeds, rates and options."""
    function = make_runner(graphdef, optimizer_of(optimizer), config)
    return jax.jit(function, donate_argnums=0, out_shardings=everywhere), {}


class TrainingDiverged(RuntimeError):
    """A loss became NaN or infinite.

    Attributes:
        state: The state after the update that went wrong, and the others of its dispatch.
        details: Where: `epoch`, `step`, `batch` (all from 0) and `rows`, the numbers of the batch's clouds.
    """

    def __init__(self, message: str, state: TrainState, details: dict[str, Any]):
        super().__init__(message)
        self.state = state
        self.details = details


class Engine:
    """Runs epochs of one model under one optimizer.

    Args:
        model: In any mode; its arrays are copied.
        config: Settings, valid.
        plan: From `make_plan`.
        placement: Devices; None takes the default one alone.
    """

    def __init__(self, model: nnx.Module, config: TrainConfig, plan: Plan, placement: Placement | None = None):
        self.config, self.plan = config, plan
        self.placement = Placement(jax.local_devices()[:1]) if placement is None else placement
        self.placement.check(plan.batch_size)
        self.full_set = OPTIMIZERS[config.optimizer].full_set
        self.optimizer = make_optimizer(
            config.optimizer, config.learning_rate, clip_norm=config.clip_norm, **config.optimizer_options
        )
        updates = 1 if self.full_set else plan.batches
        numbers = (config.learning_rate, config.warmup_epochs * updates, config.epochs * updates)
        self.schedule = Schedule(*map(np.float32, numbers))  # pyright: ignore[reportArgumentType]
        own = nnx.merge(*nnx.split(model), copy=True)
        own.train()
        self.also = also_learnt(own)
        self.graphdef, self._params, self._rest = nnx.split(own, nnx.Param, ...)
        own.eval()
        self.eval_graphdef = nnx.split(own, nnx.Param, ...)[0]
        self.compile_seconds = 0.0
        self._run: Callable[..., tuple[TrainState, StepReport]] | None = None

    def initial_state(self) -> TrainState:
        """The state before the first update; its arrays are its own."""
        params, rest = jax.tree.map(jnp.copy, (self._params, self._rest))
        ema = None if self.config.ema_decay is None else jax.tree.map(jnp.copy, params)
        # Copied, for an optimizer may start from the parameters themselves, and a buffer can be donated once only.
        start = self.optimizer.init(params)
        opt_state = jax.tree.map(lambda x: jnp.copy(jax.lax.convert_element_type(x, x.dtype)), start)
        return self.placement.replicate(TrainState(params, rest, opt_state, ema, jnp.zeros((), jnp.int32)))

    def put(self, clouds: Clouds) -> Data:
        """The arrays of labelled clouds on the devices."""
        return self.placement.replicate(tuple(arrays_of(clouds, also=self.also)))

    def train_epoch(
        self, state: TrainState, data: Data, epoch: int, *, on_batches: Callable[[int], object] = lambda done: None
    ) -> tuple[TrainState, EpochRecord]:
        """One pass over the data; `state` is consumed.

        Args:
            state: Donated.
            data: From `put`.
            epoch: Counted from 0.
            on_batches: Called with the number of batches just done.

        Raises:
            TrainingDiverged: If a loss is not finite.
        """
        rows = epoch_rows(self.config, epoch, np.asarray(self.placement.local(data[2])), self.plan)
        run = self._compiled(state, data, self.placement.cut(rows[0]))
        start = time.perf_counter()
        reports = []
        for call, part in enumerate(rows):
            state, report = run(state, data, self.placement.cut(part), self.schedule)
            report = jax.device_get(report)
            reports.append(report)
            self._check(report, state, epoch, call, part)
            on_batches(self.plan.per_call)
        seconds = time.perf_counter() - start
        loss, correct, norm = (np.concatenate(each) for each in zip(*reports, strict=True))
        record = EpochRecord(
            epoch=epoch + 1,
            train_loss=float(loss.mean(dtype=np.float64)),
            train_overall=float(correct.sum() / (self.plan.batches * self.plan.batch_size)),
            validation_loss=None,
            validation_overall=None,
            validation_class_average=None,
            learning_rate=float(
                rate_at(self.placement.local(state.step) - 1, self.schedule, kind=self.config.schedule)
            ),
            grad_norm=float(norm.mean(dtype=np.float64)),
            seconds=seconds,
            losses=loss.tolist(),
        )
        return state, record

    def weights(self, state: TrainState) -> tuple[Any, Any]:
        """`(params, rest)` to evaluate: the averaged parameters where there are any."""
        if state.ema is not None:
            return state.ema, state.rest
        return evaluation_params(state.opt_state, state.params), state.rest

    def evaluate(self, state: TrainState, split: Clouds) -> Metrics:
        """Metrics of the current weights on a split, in evaluation mode."""
        outputs = predict(self.eval_graphdef, self.merged(state), split, batch_size=self.config.eval_batch_size)
        return score_all(outputs, split)

    def merged(self, state: TrainState) -> Any:
        """The weights to evaluate as one state, for `eval_graphdef`."""
        return nnx.merge_state(*self.placement.local(self.weights(state)))

    def model(self, weights: tuple[Any, Any]) -> nnx.Module:
        """A model of its own in evaluation mode."""
        return nnx.merge(self.eval_graphdef, *self.placement.local(weights), copy=True)

    def _compiled(self, state: TrainState, data: Data, rows: Array) -> Callable[..., tuple[TrainState, StepReport]]:
        """The compiled training call; compiles on first use, or takes what an engine of the same program compiled."""
        if self._run is None:
            config, start = self.config, time.perf_counter()
            everywhere = None if len(self.placement.devices) == 1 else self.placement.everywhere
            jitted, compiled = _program(
                self.graphdef, optimizer_key(config.optimizer, config.clip_norm, config.optimizer_options),
                Compiled.of(config), everywhere,
            )  # fmt: skip
            arguments = (state, data, rows, self.schedule)
            shapes = jax.tree.structure(arguments), tuple(map(jax.typeof, jax.tree.leaves(arguments)))
            if shapes not in compiled:
                compiled[shapes] = jitted.lower(*arguments).compile()
                release_freed_memory()
            self._run = compiled[shapes]
            self.compile_seconds = time.perf_counter() - start
        run = self._run
        assert run is not None
        return run

    def _check(self, report: StepReport, state: TrainState, epoch: int, call: int, rows: Array) -> None:
        bad = ~np.isfinite(report.loss)
        if not bad.any():
            return
        first = int(bad.argmax())
        batch = call * self.plan.per_call + first
        step = epoch * (1 if self.full_set else self.plan.batches) + (0 if self.full_set else batch)
        details = {"epoch": epoch, "step": step, "batch": batch, "rows": np.asarray(rows[first]).tolist()}
        raise TrainingDiverged(
            f"the loss is {report.loss[first]} at step {step} (epoch {epoch + 1}, batch {batch + 1} of "
            f"{self.plan.batches}) under {self.config.optimizer} at learning rate {self.config.learning_rate}",
            state,
            details,
        )
