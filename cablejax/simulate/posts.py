"""Round things that are no cables: bottles, cans, poles and tree stems, and solids turned and shifted as a whole."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cablejax.simulate.clutter import Box

SAFE = 0.8  # of the distance told to a beam: lobes and taper make the true one a little shorter


class Post(NamedTuple):
    """A capped cylinder about its own z axis; with taper and lobes a tree stem.

    Its surface is r(z, angle) = radius + taper z + lobe cos(3 angle + z / radius): exact for a plain cylinder, and true to
    first order in the slope of taper and lobes.

    Attributes:
        radius_mm: Half-way up `[]`.
        half_mm: Half its height `[]`.
        taper: Change of the radius a millimetre of height `[]`.
        lobe_mm: How far its three lobes stand out `[]`.
        part: `Part` label `[]`.
    """

    radius_mm: Float[Array, ""]
    half_mm: Float[Array, ""]
    taper: Float[Array, ""]
    lobe_mm: Float[Array, ""]
    part: Array

    def _level(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        x, y, z = xyz
        sq = x * x + y * y
        off_axis = sq > 0  # double where: finite gradients on the axis
        rho = jnp.where(off_axis, jnp.sqrt(jnp.where(off_axis, sq, 1.0)), 0.0)
        angle = jnp.where(off_axis, jnp.arctan2(jnp.where(off_axis, y, 0.0), jnp.where(off_axis, x, 1.0)), 0.0)
        side = rho - self.radius_mm - self.taper * z - self.lobe_mm * jnp.cos(3 * angle + z / self.radius_mm)
        cap = jnp.abs(z) - self.half_mm
        out = jnp.maximum(jnp.stack([side, cap]), 0.0)
        sq_out = jnp.sum(out * out)
        away = jnp.where(sq_out > 0, jnp.sqrt(jnp.where(sq_out > 0, sq_out, 1.0)), 0.0)
        return away + jnp.minimum(jnp.maximum(side, cap), 0.0)

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """A step that no beam can take too far in mm, negative inside; 0 on the surface."""
        return SAFE * self._level(xyz)

    def near(self, xyz: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, " 3"]]:
        """Signed distance, to first order, and normal of the nearest surface point."""
        level, slope = jax.value_and_grad(self._level)(xyz)
        steep = jnp.maximum(jnp.linalg.norm(slope), 1e-6)
        return level / steep, slope / steep


class Placed(NamedTuple):
    """A solid turned, then shifted.

    Attributes:
        solid: In its own coordinates.
        rotation: From its own coordinates to the scene's `[3, 3]`.
        centre_mm: Its origin in the scene `[3]`.
    """

    solid: Box | Post
    rotation: Float[Array, "3 3"]
    centre_mm: Float[Array, " 3"]

    @property
    def part(self) -> Array:
        """`Part` label `[]`."""
        return self.solid.part

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the surface in mm, negative inside."""
        return self.solid.signed_distance(self._own(xyz))

    def near(self, xyz: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, " 3"]]:
        """Signed distance and normal of the nearest surface point."""
        distance, normal = self.solid.near(self._own(xyz))
        return distance, self.rotation @ normal

    def _own(self, xyz: Float[Array, " 3"]) -> Float[Array, " 3"]:
        return (xyz - self.centre_mm) @ self.rotation
