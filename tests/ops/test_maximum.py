"""The maximum whose gradient cannot get lost."""

import jax
import jax.numpy as jnp
import numpy as np

from cablejax.ops.maximum import largest


def test_the_compiled_gradient_behind_a_normalisation_reaches_the_largest_of_every_cell():
    values = jnp.asarray(np.random.default_rng(0).normal(size=(640, 20, 128)), jnp.float32)

    def total(values):
        mean, var = values.mean(axis=(0, 1)), values.var(axis=(0, 1))
        return largest((values - mean[None, None]) * jax.lax.rsqrt(var + 1e-5)[None, None], 1).sum()

    gradient = np.asarray(jax.jit(jax.grad(total))(values))
    scale = 1.0 / np.sqrt(np.asarray(values, np.float64).var(axis=(0, 1)) + 1e-5)
    won = np.take_along_axis(gradient, np.asarray(values).argmax(axis=1)[:, None], axis=1)[:, 0]
    # A share of -1/20 and the variance's part go to all; without the one that goes to the largest nothing is left.
    assert (won > 0.3 * scale[None]).all()


def test_the_gradient_is_that_of_the_first_of_equal_values():
    gradient = jax.grad(lambda x: largest(x, 1).sum())(jnp.array([[1.0, 3.0, 3.0], [2.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(gradient, [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def test_vmap_and_forward_mode():
    values = jnp.arange(12.0).reshape(2, 3, 2)
    np.testing.assert_array_equal(jax.vmap(lambda x: largest(x, 0))(values), values.max(axis=1))
    _, moved = jax.jvp(lambda x: largest(x, 1), (values,), (values,))
    np.testing.assert_array_equal(moved, values[:, 2])
