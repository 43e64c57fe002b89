"""One training cloud: a short piece of cable, bent at random, scanned from random directions."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from cablejax.simulate.beams import gaussian
from cablejax.simulate.clutter import Plane, Scene, bare, neighbour
from cablejax.simulate.pose import rotation_of
from cablejax.simulate.presets import PRESETS, Scanner
from cablejax.simulate.shapes import Tube, two_bends
from cablejax.simulate.surface import Part, label
from cablejax.simulate.sweeps import choose_rows, hang_in_air, packed, sweep_beams

STATIONS = 3
TIGHTEST_MM = 700.0  # bend radius; 15 diameters of the largest cable, the same for all so that it tells no size
STRATA = 20
SHARES = ((0.0, 0.7), (0.7, 0.85), (0.85, 1.0))  # of each stratum: train, validation, test


@dataclass(frozen=True)
class CloudVersion:
    """What one version of the dataset draws from, uniformly unless said otherwise.

    Attributes:
        scanner: Preset whose numbers are used.
        noise_mm: Range noise at normal incidence, log-uniform between two values; takes the preset's place.
        arc_deg: Least and largest part of the circumference seen.
        length_mm: Least and largest length seen.
        diameter_std_mm: Standard deviation of a cable's diameter about the nominal one.
        outliers: Largest share of points in the air.
        clutter: Probability that a wall stands behind the cable, and again that another cable runs beside it.
        beams_per_point: Beams sent a point; a cloud that gets too few back is padded.
    """

    scanner: Scanner
    noise_mm: tuple[float, float]
    arc_deg: tuple[float, float]
    length_mm: tuple[float, float]
    diameter_std_mm: float
    outliers: float
    clutter: float
    beams_per_point: float


LENGTH_MM = (120.0, 250.0)
VERSIONS = {
    "clean": CloudVersion(PRESETS["ideal"], (0.0, 0.0), (360.0, 360.0), LENGTH_MM, 0.0, 0.0, 0.0, 2.0),
    "standard": CloudVersion(PRESETS["line-laser"], (0.1, 0.1), (180.0, 360.0), LENGTH_MM, 0.1, 0.02, 0.0, 2.0),
    "hard": CloudVersion(PRESETS["paper-floor"], (0.3, 0.6), (60.0, 120.0), LENGTH_MM, 0.1, 0.1, 0.5, 4.5),
    "real-like": CloudVersion(PRESETS["line-laser"], (0.05, 0.4), (90.0, 270.0), LENGTH_MM, 0.2, 0.05, 0.3, 4.5),
}
FAR_MM = 1e5  # where clutter stands that is not there


def stratified(u: Float[Array, "*shape"], split: Array | int) -> Float[Array, "*shape"]:
    """Squeeze a uniform draw into the part of the 20 equal strata of [0, 1) that belongs to a split.

    70 % of each stratum is for training, 15 % for validation, 15 % for the test, so every split covers the whole range
    and no value can come up in two of them.
    """
    low, high = jnp.asarray(SHARES, jnp.float32)[split]
    cell = jnp.floor(u * STRATA)
    return (cell + low + (high - low) * (u * STRATA - cell)) / STRATA


def draw_cloud(
    nominal_mm: Float[Array, ""], numbers: dict[str, Array], limits: dict[str, Array], split: Int[Array, ""],
    key: PRNGKeyArray, *, lines: int, columns: int, n_points: int, cluttered: bool,
) -> tuple[Float[Array, "n 3"], Bool[Array, " n"], Float[Array, ""], Bool[Array, " n"]]:  # fmt: skip
    """Points `[n, 3]` in mm at a random rotation, their mask `[n]`, the true diameter, which points are the cable's `[n]`.

    A mixed pixel, whose beam hit two surfaces, is no point of the cable.

    Args:
        nominal_mm: Nominal diameter of the class.
        numbers: The scanner's, from `numbers_of`.
        limits: What to draw from, from `limits_of`.
        split: 0 train, 1 validation, 2 test.
        key: Consumed.
        lines: Scan lines a station. Static.
        columns: Beams a line. Static.
        n_points: Rows. Static.
        cluttered: Whether walls and other cables may be there; the tracing costs more where they may. Static.
    """
    keys = jax.random.split(key, 4)
    u = jax.random.uniform(keys[0], (18,))
    diameter = nominal_mm + limits["diameter_std_mm"] * gaussian(u[7])
    bends = [(2 * stratified(u[i], split) - 1) / TIGHTEST_MM for i in (0, 1)]
    tube = two_bends(0.5 * diameter, _between(limits["length_mm"], u[2]), bends[0], bends[1], 0.4)
    # without the barrier XLA works the cable out anew in every vector lane, and takes minutes to compile that
    tube = jax.lax.optimization_barrier(tube)
    middle = 2 * jnp.pi * stratified(u[3], split)
    arc = jnp.deg2rad(_between(limits["arc_deg"], u[4]))
    angles = middle + arc * ((jnp.arange(STATIONS) + 0.5) / STATIONS - 0.5)
    low, high = limits["noise_mm"]
    # log-uniform; limits of 0 keep the 0 of a scanner without noise
    numbers = {**numbers, "range_mm": low * jnp.where(low > 0, high / jnp.where(low > 0, low, 1.0), 1.0) ** u[5]}
    scene = surrounded(tube, middle, limits["clutter"], u[12:]) if cluttered else bare(tube)
    back = sweep_beams(scene, angles, arc, middle, numbers, keys[1], lines=lines, columns=columns)
    outliers = jnp.round(limits["outliers"] * u[6] * n_points).astype(jnp.int32)
    air = hang_in_air(tube, keys[2], count=n_points)
    rows = choose_rows(back, air, outliers, keys[3])
    order = packed(~rows.is_padding, n_points)  # points first, padding last
    # any pose: a canonical one has to be estimated from the points
    return (
        rows.xyz_mm[order] @ rotation_of(gaussian(u[8:12])).T,
        jnp.arange(n_points) < jnp.sum(~rows.is_padding),
        diameter,
        ((rows.part == Part.CABLE) & ~rows.is_mixed & ~rows.is_padding)[order],
    )


def surrounded(tube: Tube, middle: Array, share: Array, u: Float[Array, " 6"]) -> Scene:
    """Perhaps a wall behind the cable as seen from `middle`, and perhaps another cable beside it.

    The wall is 12 to 60 mm behind the sheath, which clears every bend; the other cable has 0.6 to 1.4 times the radius,
    runs parallel 1 to 10 mm away, within 45 degrees of the plane across the view.
    """
    radius = tube.radius_mm
    toward = jnp.stack([0 * middle, jnp.cos(middle), jnp.sin(middle)])
    wall = jnp.where(u[0] < share, radius + 12 + 48 * u[1], FAR_MM)
    side = middle + jnp.where(u[2] < 0.5, -0.5, 0.5) * jnp.pi * (1 + u[3] - 0.5)
    other = radius * (0.6 + 0.8 * u[4])
    # u[5] decides, and what is left of it within the share says how wide the gap is
    gap = radius + other + 1 + 9 * u[5] / jnp.maximum(share, 1e-6)
    there = u[5] < share
    beside = neighbour(
        tube, jnp.where(there, gap * jnp.cos(side), 0.0), jnp.where(there, gap * jnp.sin(side), FAR_MM), other
    )
    solids = (Plane(toward, -wall, label(Part.WALL)), beside)
    return jax.lax.optimization_barrier(Scene(tube, solids, 0.6 * radius))


def _between(limits: Array, u: Array) -> Array:
    return limits[0] + (limits[1] - limits[0]) * u


def limits_of(version: CloudVersion) -> dict[str, Array]:
    """The version's numbers as arrays, so that versions share one compiled program."""
    names = ("noise_mm", "arc_deg", "length_mm", "diameter_std_mm", "outliers", "clutter")
    return {name: jnp.asarray(getattr(version, name), jnp.float32) for name in names}


def raster_of(version: CloudVersion, n_points: int) -> tuple[int, int]:
    """Lines a station and columns a line; a piece is some five times as long as it is wide."""
    beams = version.beams_per_point * n_points / STATIONS
    columns = max(4, round((beams / 5) ** 0.5))
    return math.ceil(beams / columns), columns
