"""The scanner: a cable in, exactly the number of points asked for out, with the truth of every one."""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import export
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from cablejax.simulate.clutter import Cabling, Scene
from cablejax.simulate.nominal import Cable
from cablejax.simulate.presets import Scanner, numbers_of, scanner
from cablejax.simulate.scenes import make_scene
from cablejax.simulate.sheath import finish as finish_of
from cablejax.simulate.surface import around, unit
from cablejax.simulate.sweeps import Rows, choose_rows, hang_in_air, sweep_beams
from cablejax.traces import Traced

BEAMS_PER_POINT = (1.6, 3.2, 6.4, 12.8, 25.6)  # tried in turn, until enough beams come back


class Scan(NamedTuple):
    """A simulated scan with its truth, in the cable's own frame (the centreline in the plane z = 0, along x half-way).

    Attributes:
        xyz_mm: Measured points `[n, 3]`.
        signed_distance_mm: Distance of each measured point to the cable's true surface `[n]`, negative inside.
        is_outlier: True for points that hang in the air `[n]`.
        is_mixed: True for ranges averaged over the cable and what lies behind its silhouette `[n]`.
        is_impulse: True for points displaced by impulsive noise (`add_noise`) `[n]`.
        part: `Part` label of what the beam met `[n]`.
        station: Station of each point `[n]`; of a point in the air, that of a beam that it took the place of.
        true_diameter_mm: Outer diameter of the cable.
        shape: Name of the shape.
        preset: Name of the scanner preset.
        surface: The cable's true surface.
        T_cable_station: True pose of each station `[s, 4, 4]`: x along the cable, z from the station to the cable; of
            a travelling head, half-way.
        sweep: 0 for the first sweep of a station, 1 for its repeated one `[n]`.
        shift_mm: By how much registration left each sweep misplaced: by station and sweep `[s, 2, 3]`.
        finish: Name of the sheath's finish.
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
    surface: Cabling
    T_cable_station: Float[Array, "s 4 4"]
    sweep: Int[Array, " n"]
    shift_mm: Float[Array, "s 2 3"]
    finish: str


export.register_namedtuple_serialization(Rows, serialized_name="cablejax.Rows")


@Traced
@partial(jax.jit, static_argnames=("lines", "columns", "n_points"))
def _scan(scene, angles, arc, middle, numbers, outliers, key, *, lines, columns, n_points):
    keys = jax.random.split(key, 3)
    back = sweep_beams(scene, angles, arc, middle, numbers, keys[0], lines=lines, columns=columns)
    rows = choose_rows(back, hang_in_air(scene.cable, keys[1], count=n_points), outliers, keys[2])
    return rows, jax.vmap(scene.cable.signed_distance)(rows.xyz_mm), back.shift_mm


def station_pose(cable: Cabling, angle: Float[Array, ""], standoff_mm: Float[Array, ""]) -> Float[Array, "4 4"]:
    """Pose of a station that looks at the middle of the cable from `angle` around it."""
    origin = around(cable.centreline, 0.5 * cable.length_mm, angle, standoff_mm)
    middle, tangent = cable.centreline.at(0.5 * cable.length_mm)
    x = jnp.concatenate([tangent, jnp.zeros(1)])
    z = unit(jnp.concatenate([middle, jnp.zeros(1)]) - origin)
    rotation = jnp.stack([x, jnp.cross(z, x), z], axis=1)
    return jnp.eye(4).at[:3, :3].set(rotation).at[:3, 3].set(origin)


_poses = jax.jit(jax.vmap(station_pose, in_axes=(None, 0, None)))


def scan_scene(
    scene: Scene, *, device: Scanner, n_points: int, arc_deg: float | int = 360.0, stations: int = 3,
    outlier_fraction: float | int = 0.02, key: PRNGKeyArray,
) -> Scan:  # fmt: skip
    """Scan any scene with any scanner; `simulate_scan` does it by name and documents the arguments.

    The result's `shape` and `finish` are "scene", its `preset` is "scanner".

    Raises:
        ValueError: If an argument is out of range.
    """
    if n_points < 1:
        raise ValueError(f"n_points: expected at least 1, got {n_points!r}")
    if stations < 1:
        raise ValueError(f"stations: expected at least 1, got {stations!r}")
    if not 0 < arc_deg <= 360:
        raise ValueError(f"arc_deg: expected above 0 and at most 360, got {arc_deg!r}")
    if not 0 <= outlier_fraction < 1:
        raise ValueError(f"outlier_fraction: expected at least 0 and below 1, got {outlier_fraction!r}")
    arc, middle, cable = math.radians(arc_deg), math.pi / 2, scene.cable
    angles = middle + arc * ((jnp.arange(stations) + 0.5) / stations - 0.5)
    outliers = round(outlier_fraction * n_points)
    for factor in BEAMS_PER_POINT:
        lines, columns = raster_size(factor * n_points / stations, scene)
        rows, distance, shift = _scan(
            scene, angles, jnp.float32(arc), jnp.float32(middle), numbers_of(device), jnp.int32(outliers), key,
            lines=lines, columns=columns, n_points=n_points,
        )  # fmt: skip
        if not bool(rows.is_padding.any()):
            break
    else:
        raise ValueError(f"arc_deg: {arc_deg!r} leaves too little of the cable to be seen")
    poses = _poses(cable, angles, jnp.float32(device.standoff_mm))
    return Scan(
        xyz_mm=rows.xyz_mm,
        signed_distance_mm=distance,
        is_outlier=rows.is_outlier,
        is_mixed=rows.is_mixed,
        is_impulse=jnp.zeros_like(rows.is_outlier),
        part=rows.part,
        station=rows.station,
        true_diameter_mm=2 * float(cable.radius_mm),
        shape="scene",
        preset="scanner",
        surface=cable,
        T_cable_station=poses,
        sweep=rows.sweep,
        shift_mm=shift,
        finish="scene",
    )


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
    finish: str = "matte",
    key: PRNGKeyArray,
) -> Scan:
    """Scan a cable: beams, noise, losses and outliers, with the truth of every point.

    Args:
        cable: What is scanned.
        n_points: Rows of the result, exactly.
        preset: Name of the scanner, a key of `PRESETS`.
        shape: Name of the shape or scene, one of `SCENES`, or several joined by "+": see `make_scene`.
        length_mm: Scanned length of the centreline.
        bend_radius_mm: See `make_tube`.
        arc_deg: How much of the circumference is seen, 360 for all of it.
        stations: Scanner positions, spread evenly over that arc.
        outlier_fraction: Share of the rows that hang in the air, rounded to whole rows.
        finish: Name of the sheath's finish, a key of `FINISHES`: dark sheaths send back less, glossy ones dazzle.
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
    scene = make_scene(shape, diameter_mm=cable.diameter_mm, length_mm=length_mm, bend_radius_mm=bend_radius_mm)
    scan = scan_scene(
        scene._replace(finish=finish_of(finish)), device=scanner(preset), n_points=n_points, arc_deg=arc_deg, stations=stations,
        outlier_fraction=outlier_fraction, key=key,
    )  # fmt: skip
    return scan._replace(true_diameter_mm=cable.diameter_mm, shape=shape, preset=preset, finish=finish)


def station_points(scan: Scan, station: int) -> Float[Array, "m 3"]:
    """What one station measured, in its own frame, before any registration: truth for aligning scans.

    The pose `scan.T_cable_station[station]` brings the points onto the cable, without the shifts that
    `Scanner.registration_mm` leaves in `scan.xyz_mm`. Points in the air are left out.

    Raises:
        ValueError: If there is no such station.
    """
    stations = scan.T_cable_station.shape[0]
    if not 0 <= station < stations:
        raise ValueError(f"station: expected 0 to {stations - 1}, got {station!r}")
    mine = (scan.station == station) & ~scan.is_outlier
    points = (scan.xyz_mm - scan.shift_mm[scan.station, scan.sweep])[mine]
    pose = scan.T_cable_station[station]
    return (points - pose[None, :3, 3]) @ pose[:3, :3]


def raster_size(beams: float, scene: Scene) -> tuple[int, int]:
    """Scan lines and columns that make square meshes of about that many beams over the view of the cable."""
    width = 2 * float(scene.cable.outline_mm + scene.view_mm)
    columns = max(4, round(math.sqrt(beams * width / float(scene.cable.length_mm))))
    return math.ceil(beams / columns), columns
