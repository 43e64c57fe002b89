"""What every surface of a scene answers, and the labels of its parts."""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cablejax.simulate.centrelines import Centreline


class Part(IntEnum):
    """Part labels of `Scan.part`."""

    CABLE = 0
    AIR = 1
    JOINT = 2
    STRESS_CONE = 3
    TERMINATION = 4
    CLAMP = 5
    SADDLE = 6
    BRACKET = 7
    WALL = 8
    TRAY = 9
    OTHER_CABLE = 10


class SurfacePoint(NamedTuple):
    """A query's relation to a cable's surface.

    Attributes:
        signed_distance_mm: Distance to the nearest surface point `[]`, negative inside.
        normal: Outward unit normal there `[3]`.
        radius_mm: Local radius of the cross-section `[]`.
        arc_mm: Arc length along the centreline `[]`.
        angle: Angle around the centreline `[]`, radians from the in-plane normal towards z.
        part: `Part` label `[]`.
    """

    signed_distance_mm: Float[Array, ""]
    normal: Float[Array, " 3"]
    radius_mm: Float[Array, ""]
    arc_mm: Float[Array, ""]
    angle: Float[Array, ""]
    part: Int[Array, ""]


class TubePlace(NamedTuple):
    """A query in the coordinates of a tube: along the centreline, around it, away from it.

    Attributes:
        arc_mm: Arc length of the nearest centreline point `[]`.
        angle: Angle around the centreline `[]`.
        rho_mm: Distance from the centreline `[]`.
        along: Unit tangent `[3]`.
        outward: Unit vector from the centreline to the query `[3]`, the in-plane normal on the centreline itself.
    """

    arc_mm: Float[Array, ""]
    angle: Float[Array, ""]
    rho_mm: Float[Array, ""]
    along: Float[Array, " 3"]
    outward: Float[Array, " 3"]


def tube_place(centreline: Centreline, xyz: Float[Array, " 3"]) -> TubePlace:
    """Tube coordinates of a point."""
    foot = centreline.foot(xyz)
    sq = foot.normal_mm**2 + foot.height_mm**2
    away = sq > 0
    rho = jnp.where(away, jnp.sqrt(jnp.where(away, sq, 1.0)), 0.0)  # double where: a finite gradient on the centreline
    cos = jnp.where(away, foot.normal_mm / jnp.where(away, rho, 1.0), 1.0)
    sin = jnp.where(away, foot.height_mm / jnp.where(away, rho, 1.0), 0.0)
    tx, ty = foot.tangent[0], foot.tangent[1]
    return TubePlace(
        foot.arc_mm,
        jnp.arctan2(sin, cos),
        rho,
        jnp.stack([tx, ty, jnp.zeros_like(tx)]),
        jnp.stack([-ty * cos, tx * cos, sin]),
    )


def around(
    centreline: Centreline, arc_mm: Float[Array, ""], angle: Float[Array, ""], rho_mm: Float[Array, ""]
) -> Float[Array, " 3"]:
    """The point at tube coordinates."""
    centre, tangent = centreline.at(arc_mm)
    across = rho_mm * jnp.cos(angle)
    return jnp.stack([centre[0] - tangent[1] * across, centre[1] + tangent[0] * across, rho_mm * jnp.sin(angle)])


def unit(vector: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The vector at length 1."""
    return vector / jnp.linalg.norm(vector)


def label(part: int) -> Int[Array, ""]:
    """A part label as an array."""
    return jnp.asarray(part, jnp.int32)


def locate(surface, xyz: Float[Array, "n 3"]) -> SurfacePoint:
    """Relation of many points to a surface, compiled: the fields of `SurfacePoint` with a leading axis."""
    return _locate(surface, xyz)


def signed_distance(surface, xyz: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Distance of many points to a surface in mm, negative inside, compiled."""
    return _signed_distance(surface, xyz)


@jax.jit
def _locate(surface, xyz):
    return jax.vmap(surface.locate)(xyz)


@jax.jit
def _signed_distance(surface, xyz):
    return jax.vmap(surface.signed_distance)(xyz)
