"""Matrix products of many rows with a small kernel, with backward passes that suit a CPU."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from cablejax.ops.cloud_by_cloud import cloud_by_cloud


@jax.custom_vjp
def row_product(rows: Float[Array, "n c"], kernel: Float[Array, "c d"]) -> Float[Array, "n d"]:
    """`rows @ kernel`.

    Autodiff's product for the kernel's gradient takes the incoming gradient as the left side, which XLA on the CPU
    copies transposed, computing it anew in that order; here the rows, narrower and already in memory, take that place.
    """
    return rows @ kernel


def _row_product_forward(rows: Array, kernel: Array) -> tuple[Array, tuple[Array, Array]]:
    return row_product(rows, kernel), (rows, kernel)


def _row_product_backward(residuals: tuple[Array, Array], grad: Array) -> tuple[Array, Array]:
    rows, kernel = residuals
    grad = lax.optimization_barrier(grad)  # computed once, for two products
    return grad @ kernel.T, lax.dot_general(rows, grad, (((0,), (0,)), ((), ())))


row_product.defvjp(_row_product_forward, _row_product_backward)


@jax.custom_vjp
def gram(rows: Float[Array, "b n c"]) -> Float[Array, "c c"]:
    """`sum of x x^T` over all rows x of a batch, in full precision; the gradient is one product, not two."""

    def one(cloud: Float[Array, "n c"]) -> Float[Array, "c c"]:
        return lax.dot_general(cloud, cloud, (((0,), (0,)), ((), ())), precision=lax.Precision.HIGHEST)

    return jnp.sum(jax.vmap(cloud_by_cloud(one))(rows), axis=0)


def _gram_forward(rows: Array) -> tuple[Array, Array]:
    return gram(rows), rows


def _gram_backward(rows: Array, grad: Array) -> tuple[Array]:
    return (jnp.matmul(rows, grad + grad.T, precision=lax.Precision.HIGHEST),)


gram.defvjp(_gram_forward, _gram_backward)
