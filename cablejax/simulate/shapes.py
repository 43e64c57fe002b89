"""Cable shapes: round tubes about a plane centreline, with exact signed distance, normal and local radius."""

from functools import partial
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cablejax.simulate.centrelines import ArcChain, Catenary, Centreline, arc_chain
from cablejax.simulate.surface import Part, SurfacePoint, around, label, tube_place

Shape = Literal["straight", "bend", "s-bend", "catenary"]
SHAPES: tuple[str, ...] = get_args(Shape)
BEND_RADIUS_DIAMETERS = 15.0  # the usual least bend radius of an installed single-core cable
SMALLEST_RADIUS_DIAMETERS = 2.0  # tighter, and the tube comes near to its own centre of curvature


class Tube(NamedTuple):
    """A tube of constant radius. It runs on without end caps; a scan covers arc lengths 0 to `length_mm`.

    Attributes:
        centreline: The curve, in the plane z = 0, curving nowhere tighter than the radius.
        radius_mm: Radius `[]`.
        length_mm: Scanned length of the centreline `[]`.
    """

    centreline: Centreline
    radius_mm: Float[Array, ""]
    length_mm: Float[Array, ""]

    @property
    def outline_mm(self) -> Float[Array, ""]:
        """Largest radius."""
        return self.radius_mm

    def signed_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance of a point to the surface in mm, negative inside: the distance to the centreline less the radius."""
        return jnp.sqrt(self.centreline.sq_distance(xyz) + xyz[2] ** 2) - self.radius_mm

    def bound(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """A step that no beam can take too far; the signed distance itself."""
        return self.signed_distance(xyz)

    def locate(self, xyz: Float[Array, " 3"]) -> SurfacePoint:
        """Signed distance, normal and place on the surface; on the centreline itself the normal is the in-plane one."""
        place = tube_place(self.centreline, xyz)
        return SurfacePoint(
            place.rho_mm - self.radius_mm, place.outward, self.radius_mm, place.arc_mm, place.angle, label(Part.CABLE)
        )

    def point(self, arc_mm: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, " 3"]:
        """The surface point at an arc length and an angle around the centreline."""
        return around(self.centreline, arc_mm, angle, self.radius_mm)


def make_tube(
    shape: str, *, diameter_mm: float | int, length_mm: float | int, bend_radius_mm: float | int | None = None
) -> Tube:
    """A cable of a named shape.

    Args:
        shape: "straight"; "bend", a circular bend over the middle 60 % of the length; "s-bend", two opposite bends over
            40 % each; "catenary", hanging from both ends.
        diameter_mm: Outer diameter.
        length_mm: Length of the centreline.
        bend_radius_mm: Radius of the centreline's bends, at the lowest point for a catenary. 15 diameters by default,
            the usual least radius of an installed single-core cable; not below 2 diameters.

    Raises:
        ValueError: If the shape is unknown or a size is out of range.

    Example:
        >>> import jax.numpy as jnp
        >>> tube = make_tube("bend", diameter_mm=30.0, length_mm=400.0)
        >>> abs(float(tube.signed_distance(tube.point(jnp.array(200.0), jnp.array(1.0))))) < 1e-4
        True
    """
    if shape not in SHAPES:
        raise ValueError(f"shape: expected one of {', '.join(SHAPES)}, got {shape!r}")
    if not diameter_mm > 0:
        raise ValueError(f"diameter_mm: expected a number above 0, got {diameter_mm!r}")
    if not length_mm > 0:
        raise ValueError(f"length_mm: expected a number above 0, got {length_mm!r}")
    bend_radius_mm = BEND_RADIUS_DIAMETERS * diameter_mm if bend_radius_mm is None else bend_radius_mm
    least = SMALLEST_RADIUS_DIAMETERS * diameter_mm
    if not bend_radius_mm >= least:
        raise ValueError(f"bend_radius_mm: expected at least 2 diameters, {least:g}, got {bend_radius_mm!r}")
    return build_tube(shape, jnp.float32(diameter_mm), jnp.float32(length_mm), jnp.float32(bend_radius_mm))


@partial(jax.jit, static_argnames=("shape",), inline=True)
def build_tube(shape: str, diameter_mm: Array, length_mm: Array, bend_radius_mm: Array) -> Tube:
    """`make_tube` without its checks, for sizes that are traced arrays. `shape` is static."""
    if shape == "catenary":
        half_span = bend_radius_mm * jnp.arcsinh(0.5 * length_mm / bend_radius_mm)
        return Tube(Catenary(bend_radius_mm, half_span), 0.5 * diameter_mm, length_mm)
    bend = 1 / bend_radius_mm
    first = {"straight": 0.0, "bend": bend, "s-bend": bend}[shape]
    second = {"straight": 0.0, "bend": bend, "s-bend": -bend}[shape]
    return two_bends(0.5 * diameter_mm, length_mm, first, second, 0.4 if shape == "s-bend" else 0.3)


def two_bends(
    radius_mm: Array, length_mm: Array, first: Array | float, second: Array | float, share: Array | float
) -> Tube:
    """Two bends of the given curvatures (1/mm) over `share` of the length each, meeting half-way, straight outside.

    Straight, bend and s-bend are all of this one form, so that a batch of clouds may mix them.
    """
    half = share * length_mm
    tail = 0.5 * length_mm - half
    pieces = [(tail, 0.0), (half, first), (half, second), (tail, 0.0)]
    return Tube(_merge_ends(pieces), radius_mm, length_mm)


def straight_run(tube: Tube, low_mm: float, high_mm: float) -> Tube:
    """A bend or an S-bend with the same curvatures whose bends lie outside the arc lengths `low_mm` to `high_mm`.

    Joints, clamps and terminations are stiff: cables bend before and behind them, over all of the length but 5 % at
    either end. Where `high_mm` is the length or more, there is only the bend before.

    Raises:
        ValueError: If the cable hangs in a catenary, or the straight part is not in order within the length.
    """
    line, length = tube.centreline, float(tube.length_mm)
    if not isinstance(line, ArcChain):
        raise ValueError(
            "tube: expected a straight or bent cable, for one that hangs in a catenary is straight nowhere"
        )
    tail = 0.05 * length
    if not tail < low_mm < high_mm:
        raise ValueError(f"low_mm, high_mm: expected above {tail:g} and in order, got {low_mm!r}, {high_mm!r}")
    high = min(high_mm, length - tail)
    pieces = [(low_mm - tail, line.curvature[1]), (high - low_mm, 0.0), (length - tail - high, line.curvature[2])]
    chain = arc_chain(pieces)
    return tube._replace(centreline=chain._replace(arc_mm=chain.arc_mm + tail))


def _merge_ends(pieces):
    """Chain whose endless straights take over the straight tails, which saves two pieces a query."""
    (tail, _), first, second, _ = pieces
    chain = arc_chain([first, second])
    return chain._replace(arc_mm=chain.arc_mm + tail)
