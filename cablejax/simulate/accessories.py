"""Accessories on a cable: joints, stress cones, terminations and clamps, as exact surfaces of revolution.

They are stiff, so they sit on a straight part of the cable; before and behind it the cable may bend.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from cablejax.simulate.centrelines import ArcChain
from cablejax.simulate.shapes import Tube
from cablejax.simulate.surface import Part, SurfacePoint, TubePlace, around, label, tube_place, unit

STRAIGHT_MM = 10.0  # how far the cable stays straight on both sides of an accessory


class Revolved(NamedTuple):
    """A polyline (arc length, radius) turned about a centreline that is straight wherever the radius changes.

    Distances are exact for a straight cable, and within `STRAIGHT_MM` of the surface for one that bends elsewhere.

    Attributes:
        centreline: Straight, or straight along the corners.
        radius_mm: Radius of the cable itself `[]`.
        length_mm: Scanned length `[]`.
        arc_mm: Arc lengths of the corners, never decreasing `[k]`.
        rho_mm: Radii of the corners `[k]`; the first and the last run on for ever.
        parts: `Part` label of the stretch from each corner to the next `[k - 1]`.
    """

    centreline: ArcChain
    radius_mm: Float[Array, ""]
    length_mm: Float[Array, ""]
    arc_mm: Float[Array, " k"]
    rho_mm: Float[Array, " k"]
    parts: Int[Array, " segments"]

    @property
    def outline_mm(self) -> Float[Array, ""]:
        """Largest radius."""
        return jnp.max(self.rho_mm)

    def radius_at(self, arc_mm: Float[Array, ""]) -> Float[Array, ""]:
        """Radius at an arc length; at a step, of what follows it."""
        return jnp.interp(arc_mm, self.arc_mm, self.rho_mm)

    def bound(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """A step that no beam can take too far: the signed distance, shortened inside a bend, where lengths shrink."""
        place = tube_place(self.centreline, xyz)
        curvature = jnp.max(jnp.abs(self.centreline.curvature))
        shrink = jnp.maximum(1 - curvature * place.rho_mm, 0.1)
        return jnp.maximum(place.rho_mm - self.outline_mm, shrink * self._from(place).signed_distance_mm)

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the surface in mm, negative inside."""
        return self.locate(xyz).signed_distance_mm

    def point(self, arc_mm: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, " 3"]:
        """The surface point at an arc length and an angle around the centreline."""
        return around(self.centreline, arc_mm, angle, self.radius_at(arc_mm))

    def locate(self, xyz: Float[Array, " 3"]) -> SurfacePoint:
        """Signed distance, normal and place of the nearest surface point: the nearest stretch of the polyline."""
        return self._from(tube_place(self.centreline, xyz))

    def _from(self, place: TubePlace) -> SurfacePoint:
        s, rho = place.arc_mm, place.rho_mm
        # the first and the last stretch run on: their outer corners move beyond the query
        arc = self.arc_mm.at[0].min(s - 1.0).at[-1].max(s + 1.0)
        ds, dr = arc[1:] - arc[:-1], self.rho_mm[1:] - self.rho_mm[:-1]
        share = jnp.clip(((s - arc[:-1]) * ds + (rho - self.rho_mm[:-1]) * dr) / (ds * ds + dr * dr), 0.0, 1.0)
        off_s, off_r = s - arc[:-1] - share * ds, rho - self.rho_mm[:-1] - share * dr
        sq_dist = off_s**2 + off_r**2
        best = jnp.argmin(sq_dist)
        inside = rho < self.radius_at(s)
        distance = jnp.where(inside, -1.0, 1.0) * jnp.sqrt(sq_dist[best])
        normal = unit(ds[best] * place.outward - dr[best] * place.along)
        at = arc[best] + share[best] * ds[best]
        radius = self.rho_mm[best] + share[best] * dr[best]
        return SurfacePoint(distance, normal, radius, at, place.angle, self.parts[best])


def revolve(tube: Tube, corners: list[tuple[float, float]], parts: list[int]) -> Revolved:
    """A cable whose radius follows corners (arc length, radius), with the part label of each stretch.

    Raises:
        ValueError: If the cable is not straight along the corners and `STRAIGHT_MM` beyond, or the corners are not in
            order or too few.
    """
    arcs = np.array([arc for arc, _ in corners])
    if len(corners) < 2 or (np.diff(arcs) < 0).any() or len(parts) != len(corners) - 1:
        raise ValueError(f"corners: expected at least 2 in order and one part less, got {corners} and {parts}")
    line = tube.centreline
    if not isinstance(line, ArcChain) or _bends_within(line, arcs[0] - STRAIGHT_MM, arcs[-1] + STRAIGHT_MM):
        where = f"{arcs[0] - STRAIGHT_MM:g} to {arcs[-1] + STRAIGHT_MM:g} mm"
        raise ValueError(f"tube: expected a cable that is straight from {where}, for an accessory does not bend")
    first, second = (jnp.asarray(column, jnp.float32) for column in zip(*corners, strict=True))
    return Revolved(line, tube.radius_mm, tube.length_mm, first, second, jnp.stack([label(part) for part in parts]))


def _bends_within(line: ArcChain, low_mm: float, high_mm: float) -> bool:
    start, length, curvature = (np.asarray(x) for x in (line.arc_mm, line.length_mm, line.curvature))
    return bool(((curvature != 0) & (length > 0) & (start < high_mm) & (start + length > low_mm)).any())


def with_joint(tube: Tube, *, radius_mm: float, length_mm: float, taper_mm: float = 20.0) -> Revolved:
    """A joint half-way: a thicker barrel, tapered over `taper_mm` at both ends, or stepped where that is 0."""
    r, middle = float(tube.radius_mm), 0.5 * float(tube.length_mm)
    low, high = middle - 0.5 * length_mm, middle + 0.5 * length_mm
    corners = [
        (low - 1, r),
        (low, r),
        (low + taper_mm, radius_mm),
        (high - taper_mm, radius_mm),
        (high, r),
        (high + 1, r),
    ]
    return revolve(tube, corners, [Part.CABLE, Part.JOINT, Part.JOINT, Part.JOINT, Part.CABLE])


def with_stress_cone(tube: Tube, *, radius_mm: float, length_mm: float) -> Revolved:
    """A stress cone half-way: a slow rise over 70 % of its length, a faster fall over the rest."""
    r, middle = float(tube.radius_mm), 0.5 * float(tube.length_mm)
    low, high = middle - 0.5 * length_mm, middle + 0.5 * length_mm
    corners = [(low - 1, r), (low, r), (low + 0.7 * length_mm, radius_mm), (high, r), (high + 1, r)]
    return revolve(tube, corners, [Part.CABLE, Part.STRESS_CONE, Part.STRESS_CONE, Part.CABLE])


def with_termination(tube: Tube, *, core_mm: float, shed_mm: float, sheds: int = 4) -> Revolved:
    """The sheath ends half-way; beyond, the insulated core of radius `core_mm` carries `sheds` rain sheds `shed_mm` wide."""
    r, middle, length = float(tube.radius_mm), 0.5 * float(tube.length_mm), float(tube.length_mm)
    pitch = 0.5 * length / (sheds + 1)
    corners, parts = [(middle - 1, r), (middle, r), (middle, core_mm)], [Part.CABLE, Part.TERMINATION]
    for shed in range(1, sheds + 1):
        at = middle + shed * pitch
        corners += [(at - 4, core_mm), (at - 1, shed_mm), (at + 1, shed_mm), (at + 4, core_mm)]
        parts += [Part.TERMINATION] * 4
    return revolve(tube, [*corners, (max(length, corners[-1][0]), core_mm)], [*parts, Part.TERMINATION])


def with_clamp(tube: Tube, *, thickness_mm: float = 6.0, width_mm: float = 30.0) -> Revolved:
    """A clamp round the cable half-way: a stepped ring."""
    r, middle = float(tube.radius_mm), 0.5 * float(tube.length_mm)
    low, high, top = middle - 0.5 * width_mm, middle + 0.5 * width_mm, float(tube.radius_mm) + thickness_mm
    corners = [(low - 1, r), (low, r), (low, top), (high, top), (high, r), (high + 1, r)]
    return revolve(tube, corners, [Part.CABLE, Part.CLAMP, Part.CLAMP, Part.CLAMP, Part.CABLE])
