"""Which neighbours lie on a point's own sheet: those through a thin wall are near in space and no part of its surface."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from cablejax.ops.factors import TINY
from cablejax.ops.slots import Vector, along, offsets, sq_length, sum_over_slots
from cablejax.ops.surface_fit import SurfaceFit, fit_surface, tangents
from cablejax.ops.varying import varying_like

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

    def sample(rows: Array, near: Array) -> tuple[Array, Vector]:
        offset = offsets(xyz, rows, centre)
        return jnp.where(near, jnp.exp(-sq_length(offset) * scale), 0.0), offset

    tilted, lift = _plane(fit_surface(sample, neighbors, order=1))

    def halves(level: Array) -> tuple[Vector, ...]:
        """Counts, weights, weighted heights and their squares, of the half above and of the one below."""

        def sums(rows: Array, near: Array) -> tuple[Vector, ...]:
            weight, offset = sample(rows, near)
            height = along(tilted, offset) - lift
            upper = height > level
            above, below = jnp.where(upper, weight, 0.0), jnp.where(upper, 0.0, weight)
            counts = (near & upper).astype(weight.dtype), (near & ~upper).astype(weight.dtype)
            first = above * height, below * height
            return counts, (above, below), first, (first[0] * height, first[1] * height)

        return sum_over_slots(neighbors, sums)

    def between(turn: Array, state: tuple[Array, tuple[Vector, ...]]) -> tuple[Array, tuple[Vector, ...]]:
        _, total, first, _ = state[1]
        upper, lower = (moment / jnp.maximum(weight, TINY) for moment, weight in zip(first, total, strict=True))
        level = 0.5 * (upper + lower)
        return level, halves(level)

    none = varying_like(jnp.zeros_like(noise), xyz, centre, neighbors)
    level, sums = lax.fori_loop(0, 1 + ROUNDS, between, (none, ((none, none),) * 4))
    count, total, first, square = map(jnp.stack, sums)
    whole = jnp.maximum(total.sum(axis=0), TINY)
    within = square - jnp.square(first) / jnp.maximum(total, TINY)
    mean = first.sum(axis=0) / whole
    spread = square.sum(axis=0) / whole - jnp.square(mean)
    apart = (within.sum(axis=0) / whole < SPLIT * spread) & (count.min(axis=0) >= FEWEST) & (noise > 0)
    own = -lift > level

    def kept(rows: Array) -> Array:
        height = along(tilted, offsets(xyz, jnp.maximum(rows, 0), centre)) - lift
        return jnp.where(apart & ((height > level) != own), -1, rows)

    return lax.map(kept, neighbors)


def _plane(fit: SurfaceFit) -> tuple[Vector, Float[Array, " m"]]:
    """Across each fitted plane, and how far along that it lies from its centre: what of an offset is height over it."""
    first, second = tangents(fit.normal)
    height, along_first, along_second = fit.coefficients
    tilted = fit.normal - along_first[None] * first - along_second[None] * second
    return tuple(tilted), height * fit.size
