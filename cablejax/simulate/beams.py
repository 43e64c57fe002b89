"""Beams: where a scanner aims, what a beam meets, and what comes back. Every function takes one beam; callers vmap."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float, Int

from cablejax.simulate.clutter import Cabling, Scene
from cablejax.simulate.shapes import Tube
from cablejax.simulate.sheath import light
from cablejax.simulate.surface import SurfacePoint, around, unit

TRACE_STEPS = 16  # sphere-tracing steps for a tube by itself, which the landing steps take from any distance
TRACE_STEPS_BEHIND = 64  # for scenes where a beam may graze one thing and meet the next
LANDING_STEPS = 5
LEAST_COSINE = 0.02  # beams within 1.1 degrees of the surface do not come back
MOST_STANDOFFS = 4  # the working range: nothing comes back from farther away
HIT_MM = 0.01  # a landed beam within this of the surface has met it


class Beam(NamedTuple):
    """A ray.

    Attributes:
        origin_mm: `[3]`.
        direction: Unit vector `[3]`.
    """

    origin_mm: Float[Array, " 3"]
    direction: Float[Array, " 3"]


class Echo(NamedTuple):
    """What a beam met.

    Attributes:
        hit: Whether the beam meets the surface within the scanned length `[]`.
        range_mm: Range of the surface, or of the closest approach of a beam that misses `[]`.
        xyz_mm: That point `[3]`; on the surface to rounding for a hit.
        cosine: Cosine of the incidence angle `[]`.
        margin_mm: How far inside the silhouette the beam passes `[]`, negative outside.
        arc_mm: Arc length along the cable `[]`.
        angle: Angle around the cable `[]`.
        part: `Part` label of what was met `[]`.
    """

    hit: Bool[Array, ""]
    range_mm: Float[Array, ""]
    xyz_mm: Float[Array, " 3"]
    cosine: Float[Array, ""]
    margin_mm: Float[Array, ""]
    arc_mm: Float[Array, ""]
    angle: Float[Array, ""]
    part: Int[Array, ""]


def aim(
    cable: Cabling, head_mm: Float[Array, ""], arc_mm: Float[Array, ""], across: Float[Array, ""],
    angle: Float[Array, ""], standoff_mm: Float[Array, ""], spread_mm: Float[Array, ""],
) -> Beam:  # fmt: skip
    """Beam from a head beside the cable towards the axis at `arc_mm`, shifted across the view.

    Args:
        cable: The cable.
        head_mm: Arc length beside which the head stands.
        arc_mm: Arc length aimed at.
        across: Place across the view, -1 to 1 from rim to rim.
        angle: Direction of the head around the cable, radians from the in-plane normal towards z.
        standoff_mm: Distance of the head from the axis.
        spread_mm: What is added to the silhouette's half-width on both sides.
    """
    origin = around(cable.centreline, head_mm, angle, standoff_mm)
    target, tangent = cable.centreline.at(arc_mm)
    view = jnp.concatenate([target, jnp.zeros(1)]) - origin
    side = unit(jnp.cross(jnp.concatenate([tangent, jnp.zeros(1)]), view))
    # a beam just touching the tube passes the axis at r / sqrt(1 - (r / d)^2), measured in the plane through the axis
    ratio = cable.outline_mm / jnp.linalg.norm(view)
    half_width = cable.outline_mm / jnp.sqrt(1 - ratio**2) + spread_mm
    return Beam(origin, unit(view + across * half_width * side))


def cast(scene: Scene, beam: Beam) -> Echo:
    """Meet the surface: sphere tracing comes near, then steps that take it for a round cylinder land on it.

    Sphere tracing alone creeps where a beam grazes the surface: 48 steps still lost beams 0.02 mm inside the rim. A beam
    that leaves lands from its nearest approach: past the surface steps double, to 1e18 mm, where no digit is left of
    the place that it comes back to.
    """
    steps = TRACE_STEPS if isinstance(scene.cable, Tube) and not scene.solids else TRACE_STEPS_BEHIND
    # at least the working range, though the bound of a profile falls a little short
    reach = 2 * MOST_STANDOFFS * (scene.cable.bound(beam.origin_mm) + scene.cable.outline_mm)

    def trace(_, state):
        t, _, nearest, least = state
        gap = scene.bound(beam.origin_mm + t * beam.direction)
        nearest, least = jnp.where(gap < least, t, nearest), jnp.minimum(gap, least)
        return jnp.minimum(t + jnp.maximum(gap, 0.0), reach), gap, nearest, least

    def land(_, state):
        xyz, t = state
        shift, _ = _to_cylinder(scene.locate(xyz), beam)
        return xyz + shift * beam.direction, t + shift

    start, far = jnp.zeros(()), jnp.full((), jnp.inf)
    t, gap, nearest, _ = jax.lax.fori_loop(0, steps, trace, (start, far, start, far))
    t = jnp.where(gap > scene.cable.outline_mm, nearest, t)
    # the last step stands outside: only there are arc length, angle and part asked for
    xyz, t = jax.lax.fori_loop(0, LANDING_STEPS - 1, land, (beam.origin_mm + t * beam.direction, t))
    surface = scene.locate(xyz)
    shift, passes = _to_cylinder(surface, beam)
    xyz, t = xyz + shift * beam.direction, t + shift
    cosine = -jnp.dot(surface.normal, beam.direction)
    facing = ~passes & (cosine > LEAST_COSINE) & (jnp.abs(surface.signed_distance_mm) < HIT_MM)
    hit = facing & _scanned(scene.cable, surface.arc_mm) & (t > 0)
    # the beam passes the axis at r sin(incidence): r - r sin = r cos^2 / (1 + sin)
    sine = jnp.sqrt(jnp.maximum(1 - cosine**2, 0.0))
    inside = surface.radius_mm * cosine**2 / (1 + sine)
    margin = jnp.where(passes, -surface.signed_distance_mm, inside)
    return Echo(
        hit=hit,
        range_mm=t,
        xyz_mm=xyz,
        cosine=cosine,
        margin_mm=margin,
        arc_mm=surface.arc_mm,
        angle=surface.angle,
        part=surface.part,
    )


def _to_cylinder(surface: SurfacePoint, beam: Beam) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """How far along the beam the local cylinder lies, or the closest approach to it, and whether the beam passes it.

    |rho n + t d| = r with rho the distance from the axis: t = rho c - root with root^2 = rho^2 c^2 - (rho^2 - r^2). On
    the way in it is written (rho^2 - r^2) / (rho c + root), which loses no digits, also where r is `FLAT_MM`.
    """
    cosine = -jnp.dot(surface.normal, beam.direction)
    rho = surface.radius_mm + surface.signed_distance_mm
    gap = surface.signed_distance_mm * (rho + surface.radius_mm)
    toward = rho * cosine
    passes = toward**2 < gap
    root = jnp.sqrt(jnp.where(passes, 0.0, toward**2 - gap))
    inward = toward > 0
    shift = jnp.where(inward, gap / jnp.where(inward, toward + root, 1.0), toward - root)
    return jnp.where(passes, toward, shift), passes


class Return(NamedTuple):
    """A measured point.

    Attributes:
        xyz_mm: `[3]`.
        valid: False for a beam that gave no point `[]`.
        is_mixed: True where the range is averaged over the cable and what lies behind it `[]`.
        angle: Angle around the cable `[]`.
        part: `Part` label of what was met `[]`.
    """

    xyz_mm: Float[Array, " 3"]
    valid: Bool[Array, ""]
    is_mixed: Bool[Array, ""]
    angle: Float[Array, ""]
    part: Int[Array, ""]


def measure(scene: Scene, beam: Beam, numbers: dict[str, Array], luck: Float[Array, " 6"]) -> Return:
    """What the scanner reports for one beam: jitter, mixed pixels, drop-outs, range noise, counting steps.

    Args:
        scene: The cable and what stands around it.
        beam: The nominal beam.
        numbers: The fields of `Scanner` as arrays `[]`.
        luck: Uniform draws on [0, 1): two tilts, the range, mixed or not, how deep, returned or not. Drawn outside, for
            all beams at once, since a key a beam costs far more to compile.
    """
    draw, chance = gaussian(luck[:3]), luck[3:]
    tilted = _tilt(beam, 1e-3 * numbers["jitter_mrad"] * draw[:2])
    echo = cast(scene, tilted)
    on_cable = ndtr(echo.margin_mm / jnp.maximum(numbers["footprint_mm"], 1e-6))
    split = (on_cable > 0.02) & (on_cable < 0.98)
    inside = (echo.hit | (echo.margin_mm < 0)) & split
    is_mixed = inside & (chance[0] < numbers["mixed_share"]) & _scanned(scene.cable, echo.arc_mm)
    behind = jnp.where(is_mixed, (1 - on_cable) * numbers["mixed_depth_mm"] * chance[1], 0.0)
    back = light(scene.finish, echo.part, echo.cosine)
    strong = jax.nn.sigmoid((back.signal - numbers["dropout_cos"]) / numbers["dropout_width"])
    kept = chance[2] < strong * (1 - back.glare)
    valid = ((echo.hit & kept) | is_mixed) & (echo.range_mm < MOST_STANDOFFS * numbers["standoff_mm"])
    grow = (echo.range_mm / numbers["standoff_mm"]) ** numbers["range_power"]
    std = (
        numbers["range_mm"]
        * grow
        / jnp.maximum(echo.cosine, 0.1) ** numbers["incidence_power"]
        / jnp.sqrt(back.diffuse)
    )
    error = behind + numbers["range_bias_mm"] + std * draw[2]
    quantum = numbers["quantum_mm"]
    counted = jnp.round((echo.range_mm + error) / jnp.where(quantum > 0, quantum, 1.0)) * quantum - echo.range_mm
    error = jnp.where(quantum > 0, counted, error)
    # the scanner believes its nominal direction, not the jittered one
    sideways = echo.range_mm * (beam.direction - tilted.direction)
    return Return(echo.xyz_mm + sideways + error * beam.direction, valid, is_mixed, echo.angle, echo.part)


def _tilt(beam: Beam, angles: Float[Array, " 2"]) -> Beam:
    """The beam turned by two small angles, in radians, about two axes across it."""
    d = beam.direction
    first = jnp.where(jnp.abs(d[2]) < 0.9, jnp.stack([d[1], -d[0], 0 * d[0]]), jnp.stack([0 * d[0], d[2], -d[1]]))
    first = first / jnp.linalg.norm(first)
    turned = d + angles[0] * first + angles[1] * jnp.cross(d, first)
    return beam._replace(direction=turned / jnp.linalg.norm(turned))


def _scanned(cable: Cabling, arc_mm: Float[Array, ""]) -> Bool[Array, ""]:
    """Whether an arc length lies in the scanned length."""
    return (arc_mm >= 0) & (arc_mm <= cable.length_mm)


def gaussian(uniform: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Standard normal draws out of uniform ones on [0, 1), by the inverse of the distribution function."""
    return math.sqrt(2.0) * jax.lax.erf_inv(2 * jnp.maximum(uniform, 2.0**-24) - 1)  # 0 would give -inf
