"""Sheaths that are not quite round: oval, eccentric, rippled by the lay below, corrugated, ribbed."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cablejax.simulate.centrelines import Centreline
from cablejax.simulate.shapes import Tube
from cablejax.simulate.surface import Part, SurfacePoint, around, label, tube_place, unit

NEWTON_STEPS = 6


class Profile(NamedTuple):
    """How the radius departs from the nominal one: r(s, a), s along the cable in mm, a around it.

    Attributes:
        oval_mm: r gains oval_mm cos 2a: the largest diameter less the smallest is four times this `[]`.
        eccentric_mm: The round sheath's centre lies this far off the centreline, towards a = 0 `[]`.
        lay_mm: Amplitude of the helical ripple lay_mm cos(strands a - 2 pi s / pitch) `[]`.
        lay_strands: Strands of the layer that shows through, a whole number `[]`.
        lay_pitch_mm: Length of lay `[]`.
        corrugation_mm: Amplitude of the rings corrugation_mm cos(2 pi s / pitch) `[]`.
        corrugation_pitch_mm: Distance of the rings `[]`.
        rib_mm: Height of the embossed ribs along the cable `[]`.
        ribs: Number of ribs, a whole number `[]`.
    """

    oval_mm: Float[Array, ""]
    eccentric_mm: Float[Array, ""]
    lay_mm: Float[Array, ""]
    lay_strands: Float[Array, ""]
    lay_pitch_mm: Float[Array, ""]
    corrugation_mm: Float[Array, ""]
    corrugation_pitch_mm: Float[Array, ""]
    rib_mm: Float[Array, ""]
    ribs: Float[Array, ""]

    def radius(self, nominal_mm: Array, arc_mm: Array, angle: Array) -> Array:
        """r(s, a) in mm."""
        off = self.eccentric_mm
        around_centre = off * jnp.cos(angle) + jnp.sqrt(nominal_mm**2 - (off * jnp.sin(angle)) ** 2)
        oval = self.oval_mm * jnp.cos(2 * angle)
        lay = self.lay_mm * jnp.cos(self.lay_strands * angle - 2 * jnp.pi * arc_mm / self.lay_pitch_mm)
        rings = self.corrugation_mm * jnp.cos(2 * jnp.pi * arc_mm / self.corrugation_pitch_mm)
        ribs = self.rib_mm * jnp.exp(4 * (jnp.cos(self.ribs * angle) - 1))
        return around_centre + oval + lay + rings + ribs

    def steepest(self, nominal_mm: Array) -> Array:
        """A bound on the slope of the surface against the round tube."""
        turn = 2 * jnp.pi
        # |d/dx exp(4 (cos x - 1))| stays below 1.17
        across = self.eccentric_mm + 2 * self.oval_mm + self.lay_strands * self.lay_mm + 1.17 * self.ribs * self.rib_mm
        along = turn * self.lay_mm / self.lay_pitch_mm + turn * self.corrugation_mm / self.corrugation_pitch_mm
        # 4/3: arc lengths shrink to 3/4 inside the tightest bend, whose radius is two diameters
        return jnp.hypot(across / nominal_mm, 4 / 3 * along) * 1.1


class ProfiledTube(NamedTuple):
    """A tube with a `Profile`; otherwise as `Tube`.

    Its signed distance is found by Newton's method from the point below the query, so it is exact (to rounding) up to
    the focal distance of the profile: within 3 mm of the sheath for everything `make_profiled` accepts.
    """

    centreline: Centreline
    radius_mm: Float[Array, ""]
    length_mm: Float[Array, ""]
    profile: Profile

    @property
    def outline_mm(self) -> Float[Array, ""]:
        """Largest radius."""
        p = self.profile
        return self.radius_mm + p.oval_mm + p.eccentric_mm + p.lay_mm + p.corrugation_mm + p.rib_mm

    def bound(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """A step that no beam can take too far: the radial gap, shortened by the steepest slope."""
        place = tube_place(self.centreline, xyz)
        gap = place.rho_mm - self.profile.radius(self.radius_mm, place.arc_mm, place.angle)
        return gap / jnp.sqrt(1 + self.profile.steepest(self.radius_mm) ** 2)

    def point(self, arc_mm: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, " 3"]:
        """The surface point at an arc length and an angle around the centreline."""
        return around(self.centreline, arc_mm, angle, self.profile.radius(self.radius_mm, arc_mm, angle))

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the surface in mm, negative inside."""
        return self.locate(xyz).signed_distance_mm

    def locate(self, xyz: Float[Array, " 3"]) -> SurfacePoint:
        """Signed distance, normal and place of the nearest surface point."""
        place = tube_place(self.centreline, xyz)

        def offset(at):
            return self.point(at[0], at[1] / self.radius_mm) - xyz  # both coordinates in mm

        def newton(_, at):
            gap, jacobian, bend = offset(at), jax.jacfwd(offset)(at), jax.jacfwd(jax.jacfwd(offset))(at)
            metric = jacobian.T @ jacobian
            curved = metric + jnp.einsum("i,ijk->jk", gap, bend)
            # away from the surface the full second derivative may lose its sign; the metric alone never does
            safe = (_det(curved) > 0.1 * _det(metric)) & (curved[0, 0] > 0)
            return at - jnp.clip(_solve(jnp.where(safe, curved, metric), jacobian.T @ gap), -3.0, 3.0)

        start = jnp.stack([place.arc_mm, place.angle * self.radius_mm])
        at = jax.lax.fori_loop(0, NEWTON_STEPS, newton, start)
        jacobian = jax.jacfwd(offset)(at)
        normal = unit(jnp.cross(jacobian[:, 1], jacobian[:, 0]))
        normal = normal * jnp.sign(jnp.dot(normal, place.outward))
        angle = at[1] / self.radius_mm
        radius = self.profile.radius(self.radius_mm, at[0], angle)
        # at the foot of the perpendicular the offset is parallel to the normal
        return SurfacePoint(-jnp.dot(offset(at), normal), normal, radius, at[0], angle, label(Part.CABLE))


def _det(m):
    return m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]


def _solve(m, v):
    """m^-1 v of a 2 x 2 system."""
    return jnp.stack([m[1, 1] * v[0] - m[0, 1] * v[1], m[0, 0] * v[1] - m[1, 0] * v[0]]) / _det(m)


def make_profiled(
    tube: Tube, *, oval_mm: float | int = 0.0, eccentric_mm: float | int = 0.0, lay_mm: float | int = 0.0,
    lay_strands: int = 12, lay_pitch_mm: float | int = 300.0, corrugation_mm: float | int = 0.0,
    corrugation_pitch_mm: float | int = 20.0, rib_mm: float | int = 0.0, ribs: int = 4,
) -> ProfiledTube:  # fmt: skip
    """A tube with the departures from roundness named in `Profile`; all amplitudes are 0 by default.

    Raises:
        ValueError: If an amplitude is negative or above 5 % of the radius, or a count or a pitch is out of range.

    Example:
        >>> from cablejax.simulate.shapes import make_tube
        >>> oval = make_profiled(make_tube("straight", diameter_mm=30.0, length_mm=100.0), oval_mm=0.25)
        >>> round(float(oval.signed_distance(jnp.array([50.0, 16.25, 0.0]))), 4)  # r = 15.25 at a = 0
        1.0
    """
    radius = float(tube.radius_mm)
    amplitudes = {"oval_mm": oval_mm, "eccentric_mm": eccentric_mm, "lay_mm": lay_mm,
                  "corrugation_mm": corrugation_mm, "rib_mm": rib_mm}  # fmt: skip
    for name, value in amplitudes.items():
        if not 0 <= value <= 0.05 * radius:
            raise ValueError(f"{name}: expected 0 to 5 % of the radius, {0.05 * radius:g}, got {value!r}")
    for name, value, least in (("lay_pitch_mm", lay_pitch_mm, 20), ("corrugation_pitch_mm", corrugation_pitch_mm, 10)):
        if not (math.isfinite(value) and value >= least):
            raise ValueError(f"{name}: expected at least {least}, got {value!r}")
    for name, value, most in (("lay_strands", lay_strands, 24), ("ribs", ribs, 12)):
        if not 1 <= value <= most:
            raise ValueError(f"{name}: expected 1 to {most}, got {value!r}")
    numbers = (oval_mm, eccentric_mm, lay_mm, lay_strands, lay_pitch_mm, corrugation_mm, corrugation_pitch_mm, rib_mm)
    profile = Profile(*(jnp.float32(number) for number in (*numbers, ribs)))
    return ProfiledTube(tube.centreline, tube.radius_mm, tube.length_mm, profile)
