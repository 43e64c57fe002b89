"""The compiled part of training: several steps a call, over data that stays on the device."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import nnx
from jaxtyping import Array, Float, Int, Num

from cablejax.train.config import MATMUL_PRECISION, TrainConfig
from cablejax.train.losses import SCORE_WEIGHT, cloud_mean, cross_entropy, gaussian_nll, score_loss
from cablejax.train.metrics import also_learnt
from cablejax.train.optimizers import OPTIMIZERS
from cablejax.train.transfer import frozen_updates


class TrainState(NamedTuple):
    """Everything that training changes; a pytree.

    Attributes:
        params: Trainable parameters (`nnx.Param`).
        rest: Running statistics and random streams.
        opt_state: The optimizer's.
        ema: Averaged parameters, None without.
        step: Updates done `[]` int32.
    """

    params: Any
    rest: Any
    opt_state: Any
    ema: Any
    step: Int[Array, ""]


class StepReport(NamedTuple):
    """What each batch of a call reported, in order.

    Attributes:
        loss: Mean loss of the batch before the update `[s]`.
        correct: Clouds of the batch classified rightly `[s]`; of labelled points the sum of the clouds' shares.
        grad_norm: Global norm of the gradient that the update took `[s]`; of the batch's own where the set's is summed.
    """

    loss: Float[Array, " s"]
    correct: Num[Array, " s"]
    grad_norm: Float[Array, " s"]


class Schedule(NamedTuple):
    """The learning rate's course, in updates.

    Attributes:
        learning_rate: The highest rate `[]`.
        warmup: Updates of linear rise `[]`.
        total: Updates of the run `[]`.
    """

    learning_rate: Float[Array, ""]
    warmup: Float[Array, ""]
    total: Float[Array, ""]


class Compiled(NamedTuple):
    """What of a run's settings is compiled in; all else are arrays, which runs of one program may differ in.

    Attributes:
        schedule: Course of the learning rate.
        label_smoothing: See `TrainConfig`, as the others.
        ema_decay: As there.
        frozen: As there.
        precision: As there.
        full_set: One update with the mean gradient over all the batches, instead of one a batch.
    """

    schedule: str
    label_smoothing: float
    ema_decay: float | None
    frozen: tuple[str, ...]
    precision: str
    full_set: bool

    @classmethod
    def of(cls, config: TrainConfig) -> "Compiled":
        """Those of a run."""
        return cls(
            config.schedule, config.label_smoothing, config.ema_decay, tuple(config.frozen), config.precision,
            OPTIMIZERS[config.optimizer].full_set,
        )  # fmt: skip


Data = tuple[Array, ...]  # xyz, mask, label, and what `also_learnt` names
Runner = Callable[[TrainState, Data, Int[Array, "s b"], Schedule], tuple[TrainState, StepReport]]


def rate_at(step: Int[Array, ""], schedule: Schedule, *, kind: str) -> Float[Array, ""]:
    """The learning rate of the update number `step`, counted from 0."""
    now = step.astype(jnp.float32)
    rise = jnp.minimum((now + 1.0) / jnp.maximum(schedule.warmup, 1.0), 1.0)
    if kind == "constant":
        return schedule.learning_rate * rise
    progress = jnp.clip((now - schedule.warmup) / jnp.maximum(schedule.total - schedule.warmup, 1.0), 0.0, 1.0)
    return schedule.learning_rate * rise * 0.5 * (1.0 + jnp.cos(jnp.pi * progress))


def make_runner(graphdef: Any, optimizer: optax.GradientTransformation, config: Compiled) -> Runner:
    """The function that trains on the batches `rows [s, b]` of the data, to be jit-compiled with its state donated.

    Args:
        graphdef: The model in training mode, split by `nnx.split(model, nnx.Param, ...)`.
        optimizer: From `make_optimizer`.
        config: Settings.
    """

    def loss_of(
        params: Any, rest: Any, xyz: Array, mask: Array, label: Array, learnt: Array | None = None
    ) -> tuple[Array, tuple[Any, Array]]:
        model = nnx.merge(graphdef, params, rest, copy=True)
        also = also_learnt(model)
        if learnt is None:
            logits, off = model(xyz, mask), 0.0
        elif also == "on_cable":
            logits, _, _, scores = model.estimate(xyz, mask)
            off = SCORE_WEIGHT * jnp.mean(score_loss(scores, learnt, mask))
        else:
            logits, mean, std = model.with_diameter(xyz, mask)
            off = jnp.mean(gaussian_nll(mean, std, learnt))
        each = cross_entropy(logits, label, label_smoothing=config.label_smoothing)
        right = jnp.argmax(logits, axis=-1) == label
        if label.ndim == 2:  # the points are labelled: every cloud counts by the mean over its own
            each, right = cloud_mean(each, mask), cloud_mean(right, mask)
        correct = jnp.sum(right, dtype=jnp.int32 if label.ndim == 1 else jnp.float32)
        return jnp.mean(each) + off, (nnx.split(model, nnx.Param, ...)[2], correct)

    def gradient(params: Any, rest: Any, data: Data, row: Array) -> tuple[Any, Any, StepReport]:
        batch = [jnp.take(each, row, axis=0) for each in data]
        with jax.default_matmul_precision(MATMUL_PRECISION[config.precision]):
            (loss, (rest, correct)), grads = jax.value_and_grad(loss_of, has_aux=True)(params, rest, *batch)
        return grads, rest, StepReport(loss, correct, optax.tree.norm(grads))

    def update(state: TrainState, grads: Any, rest: Any, schedule: Schedule) -> TrainState:
        rate = rate_at(state.step, schedule, kind=config.schedule)
        hyperparams = {**state.opt_state.hyperparams, "learning_rate": rate}
        opt_state = state.opt_state._replace(hyperparams=hyperparams)
        updates, opt_state = optimizer.update(grads, opt_state, state.params)
        params = optax.apply_updates(state.params, frozen_updates(updates, config.frozen))
        ema = state.ema
        if config.ema_decay is not None:
            keep = config.ema_decay
            ema = jax.tree.map(lambda old, new: keep * old + (1.0 - keep) * new, ema, params)
        return TrainState(params, rest, opt_state, ema, state.step + 1)

    def run(state: TrainState, data: Data, rows: Int[Array, "s b"], schedule: Schedule):
        def step(state: TrainState, row: Array) -> tuple[TrainState, StepReport]:
            grads, rest, report = gradient(state.params, state.rest, data, row)
            return update(state, grads, rest, schedule), report

        if rows.shape[0] == 1:  # no loop around image convolutions: see `make_plan`
            state, report = step(state, rows[0])
            return state, jax.tree.map(lambda leaf: leaf[None], report)
        return jax.lax.scan(step, state, rows)

    def run_full_set(state: TrainState, data: Data, rows: Int[Array, "s b"], schedule: Schedule):
        def add(carry: tuple[Any, Any], row: Array) -> tuple[tuple[Any, Any], StepReport]:
            total, rest = carry
            grads, rest, report = gradient(state.params, rest, data, row)
            return (jax.tree.map(jnp.add, total, grads), rest), report

        zero = jax.tree.map(jnp.zeros_like, state.params)
        (total, rest), report = jax.lax.scan(add, (zero, state.rest), rows)
        mean = jax.tree.map(lambda leaf: leaf / rows.shape[0], total)
        return update(state, mean, rest, schedule), report

    return run_full_set if config.full_set else run
