"""Products of many rows, and their custom gradients, against plain ones."""

import jax
import jax.numpy as jnp
import numpy as np

from cablejax.ops.product import gram, row_product


def arrays(*shapes):
    rng = np.random.default_rng(2)
    return [jnp.asarray(rng.normal(size=shape), dtype=jnp.float32) for shape in shapes]


def test_row_product_and_its_gradient():
    rows, kernel, weight = arrays((30, 4), (4, 6), (30, 6))
    np.testing.assert_allclose(row_product(rows, kernel), np.asarray(rows) @ np.asarray(kernel), rtol=1e-5, atol=1e-5)
    ours = jax.grad(lambda r, k: jnp.sum(weight * row_product(r, k) ** 2), argnums=(0, 1))(rows, kernel)
    plain = jax.grad(lambda r, k: jnp.sum(weight * (r @ k) ** 2), argnums=(0, 1))(rows, kernel)
    for one, other in zip(ours, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-3)


def test_gram_and_its_gradient():
    rows, weight = arrays((3, 20, 5), (5, 5))
    expected = np.einsum("bni,bnj->ij", np.asarray(rows, np.float64), np.asarray(rows, np.float64))
    np.testing.assert_allclose(gram(rows), expected, rtol=1e-4, atol=1e-4)
    ours = jax.grad(lambda r: jnp.sum(weight * gram(r)))(rows)  # a weight that is not symmetric
    plain = jax.grad(lambda r: jnp.sum(weight * jnp.einsum("bni,bnj->ij", r, r)))(rows)
    np.testing.assert_allclose(ours, plain, rtol=1e-4, atol=1e-4)


def test_row_product_over_a_batch_is_that_of_each_cloud():
    rows, kernel = arrays((3, 10, 4), (4, 6))
    together = jax.vmap(row_product, in_axes=(0, None))(rows, kernel)
    for one, cloud in zip(together, rows, strict=True):
        np.testing.assert_allclose(one, row_product(cloud, kernel), rtol=1e-5, atol=1e-6)
