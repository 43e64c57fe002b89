"""What stands around a cable: walls, trays, saddles, brackets, other cables; and the scene that holds them all."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cablejax.simulate.accessories import Revolved
from cablejax.simulate.centrelines import ArcChain
from cablejax.simulate.profiles import ProfiledTube
from cablejax.simulate.shapes import Tube
from cablejax.simulate.sheath import MATTE, Finish
from cablejax.simulate.surface import Part, SurfacePoint, label

Cabling = Tube | ProfiledTube | Revolved
FLAT_MM = 1e6  # radius given to flat surfaces: their rims blur no beam


class Box(NamedTuple):
    """An axis-parallel box; with a huge extent it is a wall.

    Attributes:
        centre_mm: `[3]`.
        half_mm: Half its edges `[3]`.
        part: `Part` label `[]`.
    """

    centre_mm: Float[Array, " 3"]
    half_mm: Float[Array, " 3"]
    part: Array

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the surface in mm, negative inside; exact at edges and corners too."""
        over = jnp.abs(xyz - self.centre_mm) - self.half_mm
        out = jnp.maximum(over, 0.0)
        sq = jnp.sum(out * out)
        outside = jnp.where(sq > 0, jnp.sqrt(jnp.where(sq > 0, sq, 1.0)), 0.0)  # double where: finite gradient inside
        return outside + jnp.minimum(jnp.max(over), 0.0)

    def near(self, xyz: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, " 3"]]:
        """Signed distance and normal of the nearest surface point."""
        return jax.value_and_grad(self.signed_distance)(xyz)


class Plane(NamedTuple):
    """A wall in any direction: everything behind a plane.

    Attributes:
        normal: Unit vector out of the wall `[3]`.
        level_mm: Distance of the plane from the origin along the normal `[]`.
        part: `Part` label `[]`.
    """

    normal: Float[Array, " 3"]
    level_mm: Float[Array, ""]
    part: Array

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the plane in mm, negative behind it."""
        return jnp.dot(self.normal, xyz) - self.level_mm

    def near(self, xyz: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, " 3"]]:
        """Signed distance and normal of the nearest surface point."""
        return self.signed_distance(xyz), self.normal


class Neighbour(NamedTuple):
    """Another cable: a tube, shifted.

    Attributes:
        tube: The tube.
        shift_mm: `[3]`.
        part: `Part` label `[]`.
    """

    tube: Tube
    shift_mm: Float[Array, " 3"]
    part: Array

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the surface in mm, negative inside."""
        return self.tube.signed_distance(xyz - self.shift_mm)

    def near(self, xyz: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, " 3"]]:
        """Signed distance and normal of the nearest surface point."""
        place = self.tube.locate(xyz - self.shift_mm)
        return place.signed_distance_mm, place.normal


Solid = Box | Plane | Neighbour


class Scene(NamedTuple):
    """A cable and what stands around it.

    Attributes:
        cable: The cable that is scanned.
        solids: The rest.
        view_mm: How far beyond the cable's outline the scanner looks `[]`.
        finish: How much light each part sends back.
    """

    cable: Cabling
    solids: tuple[Solid, ...]
    view_mm: Float[Array, ""]
    finish: Finish = MATTE

    def bound(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """A step that no beam can take too far."""
        nearest = self.cable.bound(xyz)
        for solid in self.solids:
            nearest = jnp.minimum(nearest, solid.signed_distance(xyz))
        return nearest

    def locate(self, xyz: Float[Array, " 3"]) -> SurfacePoint:
        """Distance to the nearest surface, its normal and label; arc length and angle are always the cable's."""
        place = self.cable.locate(xyz)
        for solid in self.solids:
            distance, normal = solid.near(xyz)
            nearer = distance < place.signed_distance_mm
            place = place._replace(
                signed_distance_mm=jnp.where(nearer, distance, place.signed_distance_mm),
                normal=jnp.where(nearer, normal, place.normal),
                radius_mm=jnp.where(nearer, FLAT_MM, place.radius_mm),
                part=jnp.where(nearer, solid.part, place.part),
            )
        return place


def bare(cable: Cabling) -> Scene:
    """A cable by itself."""
    return Scene(cable, (), jnp.zeros(()))


def box(centre_mm: tuple[float, float, float], half_mm: tuple[float, float, float], part: int) -> Box:
    """A box of plain numbers."""
    return Box(jnp.asarray(centre_mm, jnp.float32), jnp.asarray(half_mm, jnp.float32), label(part))


def wall(cable: Cabling, *, gap_mm: float = 5.0) -> Scene:
    """A wall below (z lower than) the cable, `gap_mm` away from it."""
    top = -float(cable.outline_mm) - gap_mm
    return Scene(cable, (box((0.0, 0.0, top - 500.0), (1e4, 1e4, 500.0), Part.WALL),), jnp.float32(20.0))


def tray(cable: Cabling, *, width_mm: float | None = None, height_mm: float = 50.0, sheet_mm: float = 2.0) -> Scene:
    """A straight tray of sheet metal with two sides, the cable lying on its floor.

    It is 150 mm wide, or as wide as a bent cable needs with 10 mm to spare on both sides.
    """
    r = float(cable.outline_mm)
    half = 0.5 * float(cable.length_mm)
    half_width = max(75.0, _reach(cable) + 10.0) if width_mm is None else 0.5 * width_mm
    floor = -r - 0.5 * sheet_mm
    side = (half, 0.5 * sheet_mm, 0.5 * height_mm)
    middle = floor + 0.5 * height_mm
    solids = (
        box((0.0, 0.0, floor), (half, half_width, 0.5 * sheet_mm), Part.TRAY),
        box((0.0, half_width, middle), side, Part.TRAY),
        box((0.0, -half_width, middle), side, Part.TRAY),
    )
    return Scene(cable, solids, jnp.float32(half_width - r + 5.0))


def _reach(cable: Cabling) -> float:
    """How far the cable reaches to either side of the line y = 0."""
    arc = jnp.linspace(0.0, float(cable.length_mm), 201)
    points = jax.vmap(lambda s: cable.centreline.at(s)[0])(arc)
    return float(jnp.max(jnp.abs(points[:, 1])) + cable.outline_mm)


def support(cable: Cabling) -> Scene:
    """A saddle under the middle of the cable, on a bracket."""
    r = float(cable.outline_mm)
    solids = (
        box((0.0, 0.0, -r - 6.0), (20.0, 1.2 * r, 6.0), Part.SADDLE),
        box((0.0, 0.0, -r - 42.0), (8.0, 8.0, 30.0), Part.BRACKET),
    )
    return Scene(cable, solids, jnp.float32(20.0))


def neighbour(cable: Tube, across_mm: Array, up_mm: Array, radius_mm: Array) -> Neighbour:
    """A cable of any radius that runs along another one, straight or bent, at constant offsets from its axis."""
    assert isinstance(cable.centreline, ArcChain)
    beside = Tube(cable.centreline.parallel(across_mm), radius_mm, cable.length_mm)
    return Neighbour(beside, jnp.stack([0 * up_mm, 0 * up_mm, up_mm]), label(Part.OTHER_CABLE))


def neighbours(cable: Cabling, offsets_mm: list[tuple[float, float]]) -> Scene:
    """Round cables of the same radius that run along the cable, also round its bends; seen as far as their axes.

    Args:
        cable: The cable that is scanned: straight or of circular bends.
        offsets_mm: Of each neighbour's axis: across (along the in-plane normal) and up (along z).

    Raises:
        ValueError: If the cable hangs in a catenary, whose parallels are none, or an offset reaches the centre of a bend.
    """
    line = cable.centreline
    if not isinstance(line, ArcChain):
        raise ValueError(
            "cable: expected a straight or bent one, since curves parallel to a catenary are no catenaries"
        )
    for across, _ in offsets_mm:
        if bool((line.curvature * (abs(across) + cable.radius_mm) >= 1).any()):
            raise ValueError(f"offsets_mm: expected less than the bend radius, got {across!r} across")
    along = Tube(line, cable.radius_mm, cable.length_mm)
    solids = tuple(neighbour(along, jnp.float32(a), jnp.float32(up), cable.radius_mm) for a, up in offsets_mm)
    reach = max(math.hypot(*offset) for offset in offsets_mm) - float(cable.radius_mm)
    return Scene(cable, solids, jnp.float32(max(reach, 0.0)))


def trefoil(cable: Cabling) -> Scene:
    """Three touching round cables; the scanned one is the upper.

    Raises:
        ValueError: If the cable hangs in a catenary or bends more tightly than its neighbours can.
    """
    r = float(cable.radius_mm)
    return neighbours(cable, [(r, -(3**0.5) * r), (-r, -(3**0.5) * r)])
