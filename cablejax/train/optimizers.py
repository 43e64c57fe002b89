"""Optimizers by name, each with its learning rate in the state: changing it costs no compilation."""

import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import optax
from optax.contrib import ScheduleFreeState, schedule_free_eval_params


class Recipe(NamedTuple):
    """How an optimizer is made, and what it is given where the caller says nothing.

    Attributes:
        factory: Takes `learning_rate` and the options.
        options: The options' defaults.
        learning_rate: A rate that trains ADGCNN on cables; a starting point for tuning, never applied silently.
        full_set: Whether one update takes the gradient of the whole training set.
        static: Options and parameters of `factory` that are no arrays.
    """

    factory: Callable[..., optax.GradientTransformation]
    options: Mapping[str, Any]
    learning_rate: float
    full_set: bool = False
    static: tuple[str, ...] = ()


OPTIMIZERS: Mapping[str, Recipe] = MappingProxyType(
    {
        # Gradient descent on the whole set, which the paper abbreviates SGD and sets apart from MBGD.
        "sgd": Recipe(optax.sgd, {}, 0.1, full_set=True),
        "mbgd": Recipe(optax.sgd, {}, 0.05),
        # Zeiler's rho and eps; eqs. (18)-(19) have no learning rate, which is a rate of 1.
        "adadelta": Recipe(optax.adadelta, {"rho": 0.95, "eps": 1e-6}, 1.0),
        "adagrad": Recipe(optax.adagrad, {"initial_accumulator_value": 0.1, "eps": 1e-7}, 0.01),
        "rmsprop": Recipe(optax.rmsprop, {"decay": 0.9, "eps": 1e-8}, 0.001),
        "adam": Recipe(optax.adam, {"b1": 0.9, "b2": 0.999, "eps": 1e-8}, 0.001),
        "adamw": Recipe(optax.adamw, {"b1": 0.9, "b2": 0.999, "eps": 1e-8, "weight_decay": 0.01}, 0.001),
        # Newton-Schulz orthogonalised momentum for matrices, Adam for the rest (Jordan et al., 2024).
        "muon": Recipe(optax.contrib.muon, {"beta": 0.95, "weight_decay": 0.0}, 0.02, static=("ns_steps",)),
        # Defazio et al., 2024; it stands for a schedule, so that the rate is best left constant behind its warm-up.
        "schedule_free": Recipe(
            optax.contrib.schedule_free_adamw,
            {"b1": 0.9, "b2": 0.999, "eps": 1e-8, "weight_decay": 0.0},
            0.0025,
        ),
    }
)


def make_optimizer(
    name: str, learning_rate: float, *, clip_norm: float | None = None, **options: Any
) -> optax.GradientTransformation:
    """An optax optimizer whose state holds the learning rate and the options as arrays (`state.hyperparams`).

    Args:
        name: One of `OPTIMIZERS`. "sgd" is the full-set method: the update itself is "mbgd"'s, and the training loop
            gives it the mean gradient of the whole set.
        learning_rate: Always explicit; 1.0 is Adadelta as published, eqs. (17)-(19).
        clip_norm: Gradients of a larger global norm are scaled down to it; None leaves them.
        **options: The optimizer's own, in place of the recipe's.

    Raises:
        ValueError: If the name or an option is unknown, or a number is not positive where it must be.

    Example:
        >>> import jax.numpy as jnp
        >>> optimizer = make_optimizer("adadelta", 1.0)
        >>> optimizer.init(jnp.zeros(2)).hyperparams["rho"].item()
        0.949999988079071
    """
    if name not in OPTIMIZERS:
        raise ValueError(f"name: expected one of {', '.join(OPTIMIZERS)}, got {name!r}")
    if not learning_rate > 0:
        raise ValueError(f"learning_rate: expected a number above 0, got {learning_rate}")
    if clip_norm is not None and not clip_norm > 0:
        raise ValueError(f"clip_norm: expected a number above 0 or None, got {clip_norm}")
    recipe = OPTIMIZERS[name]
    unknown = set(options) - set(recipe.options) - ({"momentum", "nesterov"} if recipe.factory is optax.sgd else set())
    if unknown:
        known = ", ".join(recipe.options) or "momentum, nesterov"
        raise ValueError(f"options: {name} takes {known}; got {', '.join(sorted(unknown))}")

    @functools.wraps(recipe.factory)  # its signature tells inject_hyperparams the numbers
    def clipped(learning_rate: Any, **chosen: Any) -> optax.GradientTransformation:
        inner = recipe.factory(learning_rate, **chosen)
        return inner if clip_norm is None else optax.chain(optax.clip_by_global_norm(clip_norm), inner)

    static = (*recipe.static, *(key for key, value in options.items() if isinstance(value, bool)))
    return optax.inject_hyperparams(clipped, static_args=static)(
        learning_rate=learning_rate, **{**recipe.options, **options}
    )


class OptimizerKey(NamedTuple):
    """What of an optimizer is compiled in: all but the numbers, which its state holds.

    Attributes:
        name: One of `OPTIMIZERS`.
        clip_norm: See `make_optimizer`.
        numbers: Names of the options given that are numbers.
        others: The options given that are none, with their values.
    """

    name: str
    clip_norm: float | None
    numbers: frozenset[str]
    others: frozenset[tuple[str, Any]]


def optimizer_key(name: str, clip_norm: float | None, options: Mapping[str, Any]) -> OptimizerKey:
    """The same for optimizers that differ in rate and numbers alone: a program compiled for one does for all."""
    numbers = {key for key, value in options.items() if _is_number(value)}
    others = frozenset((key, value) for key, value in options.items() if key not in numbers)
    return OptimizerKey(name, clip_norm, frozenset(numbers), others)


def optimizer_of(key: OptimizerKey) -> optax.GradientTransformation:
    """An optimizer of a key; its updates go by the numbers of the state that it is given."""
    options = {**dict.fromkeys(key.numbers, 0.5), **dict(key.others)}
    return make_optimizer(key.name, 1.0, clip_norm=key.clip_norm, **options)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def evaluation_params(opt_state: Any, params: Any) -> Any:
    """The parameters to evaluate: the running average where the optimizer is schedule-free, else those that it updates."""
    leaves = jax.tree.leaves(opt_state, is_leaf=_is_schedule_free)
    found = [leaf for leaf in leaves if _is_schedule_free(leaf)]
    return schedule_free_eval_params(found[0], params) if found else params


def _is_schedule_free(node: Any) -> bool:
    return isinstance(node, ScheduleFreeState)
