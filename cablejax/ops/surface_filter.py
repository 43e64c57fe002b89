"""Orders 1 and 2 of the adaptive filter: each point onto a plane or quadric with the weights of eq. (8)."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.factors import TINY
from cablejax.ops.filter_width import BAND, choose_alpha, pilot_rows, try_widths, usual_noise
from cablejax.ops.slots import Neighborhoods, Vector, along, farthest, gather, offsets, sq_length, sum_over_slots
from cablejax.ops.surface_fit import SurfaceFit, fit_frame, fit_heights, without_faint

FACING = 0.6  # normals that differ by so much, as a distance of unit vectors, count as one kernel width apart
UNUSUAL = 1.6  # a surface that leaves so many times the usual noise is no surface of this kernel's width
NARROWEST = 0.5  # of the width: narrower kernels hold hardly more than the point itself


class Moved(NamedTuple):
    """What became of each point.

    Attributes:
        move: From the point to its surface `[3, n]`.
        width: Kernel width `[n]`, narrowed where the first fit left too much.
        degree: Of the surface `[n]`: 2, 1, 0 for the mean, -1 where the point stays.
    """

    move: Float[Array, "3 n"]
    width: Float[Array, " n"]
    degree: Int[Array, " n"]


def onto_surface(
    around: Neighborhoods,
    edge: Float[Array, " n"] | None,
    width: Float[Array, " n"],
    usual: Float[Array, ""] | None,
    crowding: Float[Array, ""] | None,
    order: int,
    refinements: int,
) -> Moved:
    """Move each point along its normal onto its plane or quadric.

    Args:
        around: The cloud with its neighbourhoods.
        edge: Weight of each point, eq. (7); None for 1.
        width: Kernel widths, eq. (5).
        usual: Usual noise of the cloud, at which the kernel keeps its width; None if no kernel is to narrow.
        crowding: See `adaptive_filter`.
        order: 1 or 2. Static.
        refinements: See `adaptive_filter`. Static.
    """
    if usual is not None:
        first, _ = _fit(*lax.stop_gradient((around, around.xyz)), None, *lax.stop_gradient((edge, width)), order)
        width = width * _narrowing(first.noise, usual)
    fit, mean = _fit(around, around.xyz, None, edge, width, order)
    reach, move = (
        farthest(*lax.stop_gradient((around.xyz, around.xyz)), around.neighbors),
        jnp.where(fit.degree[None] > 0, fit.height[None] * fit.normal, mean),
    )
    for _ in range(refinements):
        # A constant to gradients: of a second fit most weights may be nearly none, and the gradient of its normal overflows.
        again, _ = _fit(
            *lax.stop_gradient((around, around.xyz + move, fit.normal, _trusted(edge, move, fit.noise), width)),
            order,
        )
        further = move + again.height[None] * again.normal
        # What the second fit does not determine stays with the first; a mean of means would creep along its line.
        better = (again.degree >= jnp.maximum(fit.degree, 1)) & (fit.degree > 0) & (sq_length(further) <= reach)
        fit = jax.tree.map(partial(jnp.where, better), again, fit)
        move = jnp.where(better[None], further, move)
    if crowding is not None:
        deeper = move - crowding * _depth(around, fit)
        move = jnp.where(((fit.degree == 2) & (sq_length(deeper) <= reach))[None], deeper, move)
    stays = sq_length(move) > reach
    return Moved(jnp.where(stays[None], 0.0, move), width, jnp.where(stays, -1, fit.degree))


def surface_width(around: Neighborhoods, noise: Array, order: int) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The estimate of `alpha` and of the usual noise, from some of the points; constants to gradients."""
    rows = pilot_rows(around.valid)
    at = jnp.maximum(rows, 0)
    xyz, local = lax.stop_gradient((around.xyz, jnp.where(rows >= 0, noise[at], 0.0)))
    trial = try_widths(xyz, xyz[:, at], jnp.where(rows >= 0, around.neighbors[:, at], -1), local, order=order)
    alpha = choose_alpha(trial)
    return alpha, usual_noise(trial, alpha)


def gaussian(sq_dist: Float[Array, " n"], near: Bool[Array, " n"], width: Float[Array, " n"]) -> Float[Array, " n"]:
    """The kernel of eq. (8); zero where there is no neighbour or no width."""
    safe = jnp.where(width > 0, width, 1.0)
    near = near & (width > 0)
    return jnp.where(near, jnp.exp(-jnp.where(near, sq_dist, 0.0) / (2.0 * jnp.square(safe))), 0.0)


def _fit(
    around: Neighborhoods, place: Array, normal: Array | None, edge: Array | None, width: Array, order: int
) -> tuple[SurfaceFit, Float[Array, "3 n"]]:
    """Surfaces through the measured points about given places, weighted by distance between places and normals.

    With them the weighted means of the points, from the places.
    """

    def sample(rows: Array, near: Array) -> tuple[Array, Vector]:
        offset = offsets(place, rows, place)
        weight = gaussian(sq_length(offset), near, width)
        if normal is not None:
            cosine = jnp.abs(along(gather(normal, rows), normal))  # normals have either sign
            weight = weight * jnp.exp((cosine - 1.0) / FACING**2)
            offset = offsets(around.xyz, rows, place)
        weight = without_faint(weight)
        return weight if edge is None else weight * edge[rows], offset

    frame = fit_frame(sample, around.neighbors)
    return fit_heights(sample, around.neighbors, frame, order=order), frame.mean


def _narrowing(noise: Float[Array, " n"], usual: Float[Array, ""]) -> Float[Array, " n"]:
    """Share of its width that a kernel keeps whose surface leaves `noise`."""
    return lax.stop_gradient(jnp.clip(UNUSUAL * usual / jnp.maximum(noise, TINY**0.5), NARROWEST, 1.0))


def _trusted(edge: Array | None, move: Array, noise: Array) -> Array:
    """Weight of each point, less where it lies farther from its own surface than noise explains: a mixed pixel, a stray."""
    beyond = jnp.square(move).sum(axis=0) / jnp.maximum(jnp.square(BAND * noise), TINY)
    trust = jnp.exp(-0.5 * beyond)
    return trust if edge is None else edge * trust


def _depth(around: Neighborhoods, fit: SurfaceFit) -> Float[Array, "3 n"]:
    """How deep crowding has pulled each surface, along its normal.

    One fit's curvature is far noisier than its height, so the mean over the neighbours is taken, as a vector: their
    normals have either sign.
    """
    depth = (jnp.square(fit.noise) * fit.bend)[None] * fit.normal

    def sums(rows: Array, near: Array) -> tuple[Array, Vector]:
        return near.astype(depth.dtype), tuple(jnp.where(near, each, 0.0) for each in gather(depth, rows))

    count, total = sum_over_slots(around.neighbors, sums)
    return (along(total, fit.normal) / jnp.maximum(count, 1.0))[None] * fit.normal
