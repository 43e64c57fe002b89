"""What stands around a cable: walls, trays, saddles, brackets, other cables; and the scene that holds them all."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cablejax.simulate.accessories import Revolved
from cablejax.simulate.centrelines import ArcChain
from cablejax.simulate.profiles import ProfiledTube
from cablejax.simulate.shapes import Tube
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


class Neighbour(NamedTuple):
    """Another cable: a copy of a tube, shifted.

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


Solid = Box | Neighbour


class Scene(NamedTuple):
    """A cable and what stands around it.

    Attributes:
        cable: The cable that is scanned.
        solids: The rest.
        view_mm: How far beyond the cable's outline the scanner looks `[]`.
    """

    cable: Cabling
    solids: tuple[Solid, ...]
    view_mm: Float[Array, ""]

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
            distance, normal = jax.value_and_grad(solid.signed_distance)(xyz)
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


def tray(cable: Cabling, *, width_mm: float = 150.0, height_mm: float = 50.0, sheet_mm: float = 2.0) -> Scene:
    """A tray of sheet metal with two sides, the cable lying on its floor."""
    r = float(cable.outline_mm)
    floor, half = -r - 0.5 * sheet_mm, 0.5 * float(cable.length_mm)
    side = (half, 0.5 * sheet_mm, 0.5 * height_mm)
    middle = floor + 0.5 * height_mm
    solids = (
        box((0.0, 0.0, floor), (half, 0.5 * width_mm, 0.5 * sheet_mm), Part.TRAY),
        box((0.0, 0.5 * width_mm, middle), side, Part.TRAY),
        box((0.0, -0.5 * width_mm, middle), side, Part.TRAY),
    )
    return Scene(cable, solids, jnp.float32(0.5 * width_mm - r + 5.0))


def support(cable: Cabling) -> Scene:
    """A saddle under the middle of the cable, on a bracket."""
    r = float(cable.outline_mm)
    solids = (
        box((0.0, 0.0, -r - 6.0), (20.0, 1.2 * r, 6.0), Part.SADDLE),
        box((0.0, 0.0, -r - 42.0), (8.0, 8.0, 30.0), Part.BRACKET),
    )
    return Scene(cable, solids, jnp.float32(20.0))


def neighbours(cable: Tube, shifts_mm: list[tuple[float, float, float]]) -> Scene:
    """Copies of the cable beside it, at the given shifts."""
    solids = tuple(Neighbour(cable, jnp.asarray(shift, jnp.float32), label(Part.OTHER_CABLE)) for shift in shifts_mm)
    return Scene(cable, solids, jnp.float32(0.5) * cable.radius_mm)


def trefoil(cable: Tube) -> Scene:
    """Three touching cables; the scanned one is the upper.

    Raises:
        ValueError: If the cable is bent: shifted copies of a bend cut into each other.
    """
    if not isinstance(cable.centreline, ArcChain) or bool((cable.centreline.curvature != 0).any()):
        raise ValueError("cable: expected a straight one for a trefoil")
    r = float(cable.radius_mm)
    return neighbours(cable, [(0.0, r, -(3**0.5) * r), (0.0, -r, -(3**0.5) * r)])
