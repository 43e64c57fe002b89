"""Squared distances by differences, in open space or in a periodic box, and between axis-aligned boxes.

In a box each axis is a circle, and the shorter way around counts. Rounding a difference never changes the order of two of
them, so a gap between boxes as computed never exceeds the distance, as computed, of any two points in them.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def square_length(difference: Float[Array, "a ..."], box: Float[Array, " a"] | None) -> Float[Array, "..."]:
    """Squared length, summed axis by axis from the first.

    Args:
        difference: Of two points of the box, by axis `[a, ...]`.
        box: Lengths of the periodic box, inf for an axis that does not close `[a]`; none closes if None.
    """
    total = jnp.square(shorter_way(difference[0], None if box is None else box[0]))
    for axis in range(1, difference.shape[0]):
        total = total + jnp.square(shorter_way(difference[axis], None if box is None else box[axis]))
    return total


def shorter_way(difference: Float[Array, "..."], length: Float[Array, ""] | None) -> Float[Array, "..."]:
    """The difference along one axis, or what is left of the circle if that is less; its sign may be lost."""
    if length is None:
        return difference
    size = jnp.abs(difference)
    return jnp.where(size > 0.5 * length, length - size, size)


def gap(
    low: Float[Array, "..."],
    high: Float[Array, "..."],
    own_low: Float[Array, "..."],
    own_high: Float[Array, "..."],
    length: Float[Array, ""] | None,
) -> Float[Array, "..."]:
    """Least distance along one axis between a point of `[low, high]` and one of `[own_low, own_high]`."""
    direct = jnp.maximum(0.0, jnp.maximum(low - own_high, own_low - high))
    if length is None:
        return direct
    around = jnp.minimum(length - (own_high - low), length - (high - own_low))
    return jnp.minimum(direct, jnp.maximum(0.0, around))


def nearest_image(difference: Float[Array, "... a"], box: Float[Array, " a"] | None) -> Float[Array, "... a"]:
    """The difference vector of the nearest periodic images, with its sign; the axes come last."""
    if box is None:
        return difference
    length = box.reshape((1,) * (difference.ndim - 1) + box.shape)
    closes = jnp.isfinite(length)
    length = jnp.where(closes, length, 1.0)
    return difference - jnp.where(closes, length * jnp.round(difference / length), 0.0)


def wrap(xyz: Float[Array, "n a"], box: Float[Array, " a"] | None) -> Float[Array, "n a"]:
    """Coordinates within the box, between 0 and its lengths; as they are along axes that do not close."""
    if box is None:
        return xyz
    closes = jnp.isfinite(box)[None, :]
    return jnp.where(closes, jnp.mod(xyz, jnp.where(closes, box[None, :], 1.0)), xyz)
