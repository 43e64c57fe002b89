"""One table of laws for every optimizer, and Adadelta held to the paper's equations."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from cablejax.train import OPTIMIZERS, make_optimizer
from cablejax.train.optimizers import evaluation_params
from tests.reference import adadelta

RATES = {"sgd": 0.1, "mbgd": 0.1, "adadelta": 1.0, "adagrad": 0.5, "rmsprop": 0.01, "adam": 0.05, "adamw": 0.05,
         "muon": 0.02, "schedule_free": 0.05}  # fmt: skip
CURVATURE = np.array([1.0, 4.0], np.float32)
START = np.array([1.0, -2.0], np.float32)


def parabola(theta):
    return 0.5 * jnp.sum(CURVATURE * theta**2)


def step_of(optimizer, traces):
    @jax.jit
    def step(theta, state):
        traces.append(1)
        updates, state = optimizer.update(jax.grad(parabola)(theta), state, theta)
        return optax.apply_updates(theta, updates), state

    return step


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_descends_a_parabola_and_traces_once(name):
    optimizer = make_optimizer(name, RATES[name])
    traces = []
    step = step_of(optimizer, traces)
    theta = START
    state = jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), optimizer.init(theta))
    for _ in range(60):
        theta, state = step(theta, state)
    assert float(parabola(theta)) < 0.99 * float(parabola(START))
    assert len(traces) == 1


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_a_learning_rate_in_the_state_takes_effect_without_a_trace(name):
    optimizer = make_optimizer(name, RATES[name])
    traces = []
    step = step_of(optimizer, traces)
    state = jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), optimizer.init(START))
    still = state._replace(hyperparams={**state.hyperparams, "learning_rate": jnp.float32(0.0)})
    moved, _ = step(START, state)
    unmoved, _ = step(START, still)
    assert bool((moved != START).all())
    if name != "schedule_free":  # its parameters move towards the average of the steps so far
        np.testing.assert_array_equal(unmoved, START)
    assert len(traces) == 1


def test_adadelta_follows_equations_15_to_19():
    optimizer = make_optimizer("adadelta", 1.0)
    theta, state = START, optimizer.init(START)
    path = [theta]
    step = step_of(optimizer, [])
    for _ in range(50):
        theta, state = step(theta, state)
        path.append(theta)
    expected = adadelta.descend(lambda t: np.asarray(CURVATURE) * t, np.asarray(START, np.float64), 50)
    # 50 steps of float32, each rounding to 1e-7 of values near 1.
    np.testing.assert_allclose(np.array(path), expected, rtol=2e-5)


@pytest.mark.parametrize("clip_norm", [None, 100.0])
def test_schedule_free_is_evaluated_at_its_average(clip_norm):
    """x of Defazio et al., eq. (1)-(3), at a constant rate and without decay: the mean of the base iterates z."""
    optimizer = make_optimizer("schedule_free", 0.05, clip_norm=clip_norm)
    y, state = START, optimizer.init(START)
    z, x, second = (np.asarray(each, np.float64) for each in (START, START, [0.0, 0.0]))
    step = step_of(optimizer, [])
    for t in range(1, 21):
        grad = np.asarray(CURVATURE) * (0.1 * z + 0.9 * x)
        second = 0.999 * second + 0.001 * grad**2
        z = z - 0.05 * grad / (np.sqrt(second / (1 - 0.999**t)) + 1e-8)
        x = x + (z - x) / t
        y, state = step(y, state)
        np.testing.assert_allclose(evaluation_params(state, y), x, rtol=1e-4, atol=1e-5)
    assert not np.allclose(y, x, atol=1e-3)


@pytest.mark.parametrize("name", [name for name in OPTIMIZERS if name != "schedule_free"])
def test_others_are_evaluated_where_they_are(name):
    optimizer = make_optimizer(name, RATES[name])
    assert evaluation_params(optimizer.init(START), START) is START


def test_clipping_scales_the_gradient_to_the_norm():
    optimizer = make_optimizer("mbgd", 1.0, clip_norm=0.5)
    updates, _ = optimizer.update(jnp.array([3.0, 4.0]), optimizer.init(START), START)
    np.testing.assert_allclose(updates, [-0.3, -0.4], rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("newton", 1.0), {}, "name: expected one of sgd"),
        (("adam", 0.0), {}, "learning_rate: expected a number above 0, got 0.0"),
        (("adam", 1.0), {"rho": 0.9}, "options: adam takes b1, b2, eps; got rho"),
        (("sgd", 1.0), {"clip_norm": -1.0}, "clip_norm: expected a number above 0 or None"),
    ],
)
def test_wrong_settings_are_refused(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        make_optimizer(*arguments, **options)
