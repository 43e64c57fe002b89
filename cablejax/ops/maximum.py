"""The maximum with a gradient that cannot get lost."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def largest(values: Float[Array, "..."], axis: int) -> Float[Array, "..."]:
    """The maximum along an axis; its gradient goes to the first of the largest values.

    The gradient of `jnp.max` goes to the values that equal the maximum. Compiled, XLA computes values anew for that
    comparison and may round them differently (multiply and add, or both at once), and then none is equal: behind a batch
    normalisation whole channels get no gradient (jax 0.8.2 to 0.10.1).

    Args:
        values: Of any shape.
        axis: Counted from 0, the axis that goes. Static.
    """
    return jnp.max(values, axis=axis)


@largest.defjvp
def _largest_jvp(axis: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (values,), (moved,) = primals, tangents
    first = jnp.argmax(values, axis=axis, keepdims=True)
    place = jax.lax.broadcasted_iota(first.dtype, values.shape, axis)
    return jnp.max(values, axis=axis), jnp.sum(jnp.where(place == first, moved, 0.0), axis=axis)
