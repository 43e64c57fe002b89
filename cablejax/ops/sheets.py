"""Which neighbours lie on a point's own sheet: those through a thin wall are near in space and no part of its surface."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from cablejax.ops.factors import TINY
from cablejax.ops.slots import gather, sum_over_slots
from cablejax.ops.surface_fit import fit_surface, residual

SPLIT = (
    0.24  # share of the squared heights that two sheets leave within each; a Gaussian halved leaves 0.36, a block 0.25
)
ROUNDS = 2  # of 2-means: sheets seen unequally do not lie alike about the plane
FEWEST = 10  # points on either side that make a sheet: fewer gather about two levels by chance


def own_sheet(
    xyz: Float[Array, "3 n"], centre: Float[Array, "3 m"], neighbors: Int[Array, "k m"], noise: Float[Array, " m"]
) -> Int[Array, "k m"]:
    """Neighbourhoods without the neighbours that lie on another sheet than the point.

    A plane as wide as the neighbourhood passes between the two sides of a thin wall. The heights over it are parted in
    two by 2-means; where they gather about two levels (the variance within the halves is less than `SPLIT` of the
    whole), the side that the point itself is not on is left out.

    Args:
        xyz: Coordinates `[3, n]`.
        centre: The points themselves `[3, m]`.
        neighbors: Rows of each one's neighbourhood `[k, m]`, the point itself among them, -1 where there is none.
        noise: Local noise of eq. (3) `[m]`.

    Returns:
        `neighbors` with -1 in place of those left out; constants to gradients.
    """
    xyz, centre, noise = lax.stop_gradient((xyz, centre, noise))
    scale = 0.5 / jnp.square(jnp.where(noise > 0, noise, 1.0))

    def sample(rows: Array, near: Array) -> tuple[Array, Array]:
        offset = gather(xyz, rows) - centre
        return jnp.where(near, jnp.exp(-jnp.square(offset).sum(axis=0) * scale), 0.0), offset

    fit = fit_surface(sample, neighbors, order=1)
    above = residual(fit)

    def halves(level: Array) -> tuple[Array, ...]:
        def sums(rows: Array, near: Array) -> tuple[Array, ...]:
            weight, offset = sample(rows, near)
            height = above(offset)[0]
            upper = jnp.where(height > level, weight, 0.0)
            count = jnp.stack([near & (height > level), near & (height <= level)]).astype(weight.dtype)
            weights = jnp.stack([upper, weight - upper])
            return count, weights, weights * height[None], weights * jnp.square(height)[None]

        return sum_over_slots(neighbors, sums)

    def between(_: Array, level: Array) -> Array:
        _, total, first, _ = halves(level)
        return 0.5 * (first / jnp.maximum(total, TINY)).sum(axis=0)

    level = lax.fori_loop(0, ROUNDS, between, jnp.zeros_like(noise))
    count, total, first, square = halves(level)
    whole = jnp.maximum(total.sum(axis=0), TINY)
    within = square - jnp.square(first) / jnp.maximum(total, TINY)
    mean = first.sum(axis=0) / whole
    spread = square.sum(axis=0) / whole - jnp.square(mean)
    apart = (within.sum(axis=0) / whole < SPLIT * spread) & (count.min(axis=0) >= FEWEST) & (noise > 0)
    own = above(jnp.zeros_like(centre))[0] > level

    def kept(rows: Array) -> Array:
        offset = gather(xyz, jnp.maximum(rows, 0)) - centre
        other = (above(offset)[0] > level) != own
        return jnp.where(apart & other, -1, rows)

    return lax.map(kept, neighbors)
