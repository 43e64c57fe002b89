"""The scanner: a cable in, exactly the number of points asked for out, with the truth of every one."""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from cablejax.simulate.catalogue import Cable
from cablejax.simulate.presets import numbers_of, scanner
from cablejax.simulate.shapes import Tube, make_tube
from cablejax.simulate.sweeps import choose_rows, hang_in_air, sweep_beams

BEAMS_PER_POINT = (1.6, 3.2, 6.4, 12.8, 25.6)  # tried in turn, until enough beams come back


class Part:
    """Part labels of `Scan.part`."""

    CABLE = 0
    AIR = 1


class Scan(NamedTuple):
    """A simulated scan with its truth, in the cable's own frame (the centreline in the plane z = 0, along x half-way).

    Attributes:
        xyz_mm: Measured points `[n, 3]`.
        signed_distance_mm: Distance of each measured point to the true surface `[n]`, negative inside.
        is_outlier: True for points that hang in the air `[n]`.
        is_mixed: True for ranges averaged over the cable and what lies behind its silhouette `[n]`.
        is_impulse: True for points displaced by impulsive noise (`add_noise`) `[n]`.
        part: `Part` label `[n]`.
        station: Station of each point `[n]`.
        true_diameter_mm: Outer diameter of the cable.
        shape: Name of the shape.
        preset: Name of the scanner preset.
        surface: The true surface.
    """

    xyz_mm: Float[Array, "n 3"]
    signed_distance_mm: Float[Array, " n"]
    is_outlier: Bool[Array, " n"]
    is_mixed: Bool[Array, " n"]
    is_impulse: Bool[Array, " n"]
    part: Int[Array, " n"]
    station: Int[Array, " n"]
    true_diameter_mm: float
    shape: str
    preset: str
    surface: Tube


@partial(jax.jit, static_argnames=("lines", "columns", "n_points"))
def _scan(tube, angles, arc, middle, numbers, outliers, key, *, lines, columns, n_points):
    keys = jax.random.split(key, 3)
    back = sweep_beams(tube, angles, arc, middle, numbers, keys[0], lines=lines, columns=columns)
    rows = choose_rows(back, hang_in_air(tube, keys[1], count=n_points), outliers, keys[2])
    return rows, jax.vmap(tube.signed_distance)(rows.xyz_mm)


def station_angles(stations: int, arc: float, middle: float) -> list[float]:
    """Stations spread evenly over the part of the circumference that is to be seen, in radians."""
    return [middle + arc * ((i + 0.5) / stations - 0.5) for i in range(stations)]


def simulate_scan(
    cable: Cable,
    *,
    n_points: int = 53_135,
    preset: str = "line-laser",
    shape: str = "straight",
    length_mm: float | int = 400.0,
    bend_radius_mm: float | int | None = None,
    arc_deg: float | int = 360.0,
    stations: int = 3,
    outlier_fraction: float | int = 0.02,
    key: PRNGKeyArray,
) -> Scan:
    """Scan a cable: beams, noise, losses and outliers, with the truth of every point.

    Args:
        cable: What is scanned.
        n_points: Rows of the result, exactly.
        preset: Name of the scanner, a key of `PRESETS`.
        shape: Name of the shape, see `make_tube`.
        length_mm: Scanned length of the centreline.
        bend_radius_mm: See `make_tube`.
        arc_deg: How much of the circumference is seen, 360 for all of it.
        stations: Scanner positions, spread evenly over that arc.
        outlier_fraction: Share of the rows that hang in the air, rounded to whole rows.
        key: Consumed.

    Raises:
        ValueError: If an argument is out of range.

    Example:
        >>> import jax
        >>> from cablejax.simulate import catalogue
        >>> scan = simulate_scan(catalogue()[8], n_points=500, outlier_fraction=0.1, key=jax.random.key(0))
        >>> scan.xyz_mm.shape, int(scan.is_outlier.sum())
        ((500, 3), 50)
    """
    if n_points < 1:
        raise ValueError(f"n_points: expected at least 1, got {n_points!r}")
    if stations < 1:
        raise ValueError(f"stations: expected at least 1, got {stations!r}")
    if not 0 < arc_deg <= 360:
        raise ValueError(f"arc_deg: expected above 0 and at most 360, got {arc_deg!r}")
    if not 0 <= outlier_fraction < 1:
        raise ValueError(f"outlier_fraction: expected at least 0 and below 1, got {outlier_fraction!r}")
    device = scanner(preset)
    tube = make_tube(shape, diameter_mm=cable.diameter_mm, length_mm=length_mm, bend_radius_mm=bend_radius_mm)
    arc = math.radians(arc_deg)
    angles = jnp.asarray(station_angles(stations, arc, math.pi / 2), jnp.float32)
    outliers = round(outlier_fraction * n_points)
    for factor in BEAMS_PER_POINT:
        lines, columns = raster_size(factor * n_points / stations, length_mm, cable.diameter_mm)
        rows, distance = _scan(
            tube, angles, jnp.float32(arc), jnp.float32(math.pi / 2), numbers_of(device), jnp.int32(outliers), key,
            lines=lines, columns=columns, n_points=n_points,
        )  # fmt: skip
        if not bool(rows.is_padding.any()):
            break
    else:
        raise ValueError(f"arc_deg: {arc_deg!r} leaves too little of the cable to be seen")
    part = jnp.where(rows.is_outlier, Part.AIR, Part.CABLE).astype(jnp.int32)
    return Scan(
        rows.xyz_mm, distance, rows.is_outlier, rows.is_mixed,
        jnp.zeros_like(rows.is_outlier), part, rows.station, cable.diameter_mm, shape, preset, tube,
    )  # fmt: skip


def raster_size(beams: float, length_mm: float | int, diameter_mm: float) -> tuple[int, int]:
    """Scan lines and columns that make square meshes of about that many beams over the cable's outline."""
    columns = max(4, round(math.sqrt(beams * diameter_mm / length_mm)))
    return math.ceil(beams / columns), columns
