"""Sweeps: beams in scan order, their returns, outliers in the air, and a fixed number of rows drawn from both."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from cablejax.simulate.beams import aim, gaussian, measure
from cablejax.simulate.clutter import Cabling, Scene
from cablejax.simulate.surface import Part, around

RESWEPT_WINDOW = 0.25  # share of the length that the repeated sweep covers


class Raster(NamedTuple):
    """Beams in scan order: station by station, line by line along the cable, column by column across it.

    Attributes:
        arc_mm: Arc length aimed at `[m]`.
        across: Place across the view, -1 to 1 `[m]`.
        station: `[m]`.
        sweep: 0 for the first sweep, 1 for the repeated one `[m]`.
    """

    arc_mm: Float[Array, " m"]
    across: Float[Array, " m"]
    station: Int[Array, " m"]
    sweep: Int[Array, " m"]


def raster(
    length_mm: Array, variation: Array, resweep: Array, luck: Float[Array, "stations draws"], *, columns: int
) -> Raster:
    """Scan lines over the length, unevenly spaced, with one window scanned a second time.

    Args:
        length_mm: Scanned length `[]`.
        variation: Relative amplitude of the uneven speed along the cable `[]`.
        resweep: Share of the lines that repeat one window of the length `[]`.
        luck: Uniform draws on [0, 1): for every station 4 numbers and the offset of each line `[stations, 4 + lines]`.
        columns: Beams a line. Static.
    """
    stations, lines = luck.shape[0], luck.shape[1] - 4
    line = jnp.arange(lines) + 0.0
    first = jnp.round((1 - resweep) * lines)
    shape = (stations, lines)
    again = jnp.broadcast_to((line >= first)[None, :], shape)
    start = (1 - RESWEPT_WINDOW) * luck[:, :1]
    place = jnp.broadcast_to(((line + 0.5) / first)[None, :], shape)
    second = start + RESWEPT_WINDOW * ((line - first + 0.5) / jnp.maximum(lines - first, 1.0))[None, :]
    phase = 2 * jnp.pi * luck[:, None, 1:4]
    wave = 2 * jnp.pi * jnp.arange(1, 4)
    wavy = jnp.sin(place[:, :, None] * wave[None, None, :] + phase) - jnp.sin(phase)
    place = place + variation / 3 * jnp.sum(wavy / wave[None, None, :], axis=2)
    arc = length_mm * jnp.where(again, second, place)
    full = (stations, lines, columns)
    phase = luck[:, 4:, None]  # no column stays at the rim of a straight cable
    across = 2 * ((jnp.arange(columns) + 0.0)[None, None, :] + phase) / columns - 1
    return Raster(
        jnp.broadcast_to(arc[:, :, None], full).reshape(-1),
        across.reshape(-1),
        jnp.broadcast_to(jnp.arange(stations)[:, None, None], full).reshape(-1),
        jnp.broadcast_to(again[:, :, None].astype(jnp.int32), full).reshape(-1),
    )


class Returns(NamedTuple):
    """What all beams gave: `Return` with a leading axis, their origin, and what registration left.

    Attributes:
        xyz_mm: `[m, 3]`.
        valid: `[m]`.
        is_mixed: `[m]`.
        station: `[m]`.
        sweep: 0 for the first sweep of a station, 1 for the repeated one `[m]`.
        part: `[m]`.
        shift_mm: By how much each sweep is misplaced: by station, sweep `[s, 2, 3]`.
    """

    xyz_mm: Float[Array, "m 3"]
    valid: Bool[Array, " m"]
    is_mixed: Bool[Array, " m"]
    station: Int[Array, " m"]
    sweep: Int[Array, " m"]
    part: Int[Array, " m"]
    shift_mm: Float[Array, "s 2 3"]


def sweep_beams(
    scene: Scene, angles: Float[Array, " s"], arc: Float[Array, ""], middle: Float[Array, ""],
    numbers: dict[str, Array], key: PRNGKeyArray, *, lines: int, columns: int,
) -> Returns:  # fmt: skip
    """Send out every beam of every station.

    Args:
        scene: The cable and what stands around it.
        angles: Direction of each station around the cable, radians.
        arc: Part of the cable's circumference that is seen, radians, 2 pi for all.
        middle: Angle of the middle of that part.
        numbers: The fields of `Scanner` as arrays `[]`.
        key: Consumed.
        lines: Scan lines a station. Static.
        columns: Beams a line. Static.
    """
    cable, stations = scene.cable, angles.shape[0]
    beams = stations * lines * columns
    # one draw for everything: each call of the generator costs about a second to compile
    sizes = (stations * (4 + lines), 6 * beams, 6 * stations)
    draws = jnp.split(jax.random.uniform(key, (sum(sizes),)), (sizes[0], sizes[0] + sizes[1]))
    plan = raster(
        cable.length_mm, numbers["density_variation"], numbers["resweep_share"],
        draws[0].reshape(stations, 4 + lines), columns=columns,
    )  # fmt: skip
    head = jnp.where(numbers["moving_head"] > 0, plan.arc_mm, 0.5 * cable.length_mm)
    spread = 3 * numbers["footprint_mm"] + scene.view_mm
    rays = jax.vmap(aim, in_axes=(None, 0, 0, 0, 0, None, None))(
        cable, head, plan.arc_mm, plan.across, angles[plan.station], numbers["standoff_mm"], spread
    )
    back = jax.vmap(measure, in_axes=(None, 0, None, 0))(scene, rays, numbers, draws[1].reshape(beams, 6))
    off = back.angle - middle
    seen = (jnp.abs(jnp.arctan2(jnp.sin(off), jnp.cos(off))) <= 0.5 * arc) | (back.part >= Part.SADDLE)
    shift = numbers["registration_mm"] * gaussian(draws[2]).reshape(stations, 2, 3)
    return Returns(
        xyz_mm=back.xyz_mm + shift[plan.station, plan.sweep],
        valid=back.valid & seen,
        is_mixed=back.is_mixed,
        station=plan.station,
        sweep=plan.sweep,
        part=back.part,
        shift_mm=shift,
    )


def hang_in_air(cable: Cabling, key: PRNGKeyArray, *, count: int) -> Float[Array, "count 3"]:
    """Dust and stray echoes: anywhere along and around the cable, 2 mm off the surface plus an exponential of 15 mm."""
    along, turn, off = jax.random.uniform(key, (3, count))
    height = 2.0 - 15.0 * jnp.log1p(-off)
    place = jax.vmap(around, in_axes=(None, 0, 0, 0))
    return place(cable.centreline, cable.length_mm * along, 2 * jnp.pi * turn, cable.outline_mm + height)


class Rows(NamedTuple):
    """Exactly n rows out of the returns and the outliers.

    Attributes:
        xyz_mm: `[n, 3]`.
        is_outlier: `[n]`.
        is_mixed: `[n]`.
        station: `[n]`.
        sweep: `[n]`.
        part: `Part` label `[n]`.
        is_padding: True for rows that too few returns left empty `[n]`.
    """

    xyz_mm: Float[Array, "n 3"]
    is_outlier: Bool[Array, " n"]
    is_mixed: Bool[Array, " n"]
    station: Int[Array, " n"]
    sweep: Int[Array, " n"]
    part: Int[Array, " n"]
    is_padding: Bool[Array, " n"]


def packed(wanted: Bool[Array, " m"], n: int) -> Int[Array, " n"]:
    """Indices of the wanted rows in order; after the last of them, the last row of all."""
    m = wanted.shape[0]
    place = jnp.where(wanted, jnp.cumsum(wanted) - 1, n)
    return jnp.full(n, m - 1).at[place].set(jnp.arange(m), mode="drop")


def choose_rows(back: Returns, air: Float[Array, "n 3"], outliers: Int[Array, ""], key: PRNGKeyArray) -> Rows:
    """Draw n - outliers returns at random, keep them in scan order, and scatter the outliers among them.

    Where fewer returns are valid than needed, the last rows are padding.

    Args:
        back: The returns `[m]`.
        air: Candidates for the outliers `[n, 3]`.
        outliers: How many rows hang in the air.
        key: Consumed.
    """
    n, beams = air.shape[0], back.valid.shape[0]
    luck = jax.random.uniform(key, (beams + n,))
    # a value as high as the last one drawn, then places by counting: a sort that carries indices costs three times that
    priority = jnp.where(back.valid, luck[:beams], 2.0)
    last = jnp.sort(priority)[jnp.clip(n - outliers - 1, 0, beams - 1)]
    wanted = back.valid & (priority <= last) & (outliers < n)
    drawn = jnp.minimum(jnp.sum(wanted), n - outliers)  # equal draws may bring one row too many
    chosen = packed(wanted, n)
    outlier = jnp.argsort(luck[beams:]) < outliers
    rank = jnp.cumsum(~outlier) - 1
    source = chosen[jnp.clip(rank, 0)]
    return Rows(
        xyz_mm=jnp.where(outlier[:, None], air, back.xyz_mm[source]),
        is_outlier=outlier,
        is_mixed=back.is_mixed[source] & ~outlier,
        station=back.station[source],
        sweep=back.sweep[source],
        part=jnp.where(outlier, Part.AIR, back.part[source]),
        is_padding=~outlier & (rank >= drawn),
    )
