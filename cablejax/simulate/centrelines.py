"""Centrelines of cables: plane curves that know the nearest of their points to any point in space."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class Foot(NamedTuple):
    """The point of a centreline nearest to a query, and the query in the curve's own frame there.

    The frame is (tangent, normal, z): the normal is the tangent turned by +90 degrees within the plane z = 0.

    Attributes:
        arc_mm: Arc length of the foot `[]`, negative before the start.
        normal_mm: Offset of the query along the normal `[]`.
        height_mm: Offset of the query along z `[]`.
        tangent: Unit tangent at the foot `[2]`.
    """

    arc_mm: Float[Array, ""]
    normal_mm: Float[Array, ""]
    height_mm: Float[Array, ""]
    tangent: Float[Array, " 2"]


def _arc_point(arc, curvature):
    """Point of an arc that starts in the origin along x: (sin(ks)/k, (1 - cos(ks))/k), finite at k = 0."""
    turn = curvature * arc
    half = jnp.sinc(turn / (2 * jnp.pi))  # sin(x/2) / (x/2)
    return arc * jnp.sinc(turn / jnp.pi), 0.5 * arc * turn * half * half


class ArcChain(NamedTuple):
    """Straight and circular pieces joined with a common tangent; the first and the last are straight and endless.

    Attributes:
        start_mm: Start of each piece `[k, 2]`.
        heading: Direction of each piece at its start, radians `[k]`.
        curvature: Signed curvature of each piece, 1/mm `[k]`, 0 in the first and the last.
        length_mm: Length of each piece `[k]`.
        arc_mm: Arc length at the start of each piece `[k]`.
    """

    start_mm: Float[Array, "k 2"]
    heading: Float[Array, " k"]
    curvature: Float[Array, " k"]
    length_mm: Float[Array, " k"]
    arc_mm: Float[Array, " k"]

    def at(self, arc_mm: Float[Array, ""]) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """Position `[2]` and unit tangent `[2]` at an arc length."""
        piece = jnp.clip(jnp.sum(arc_mm >= self.arc_mm) - 1, 0)
        local = arc_mm - self.arc_mm[piece]
        along, across = _arc_point(local, self.curvature[piece])
        cos, sin = jnp.cos(self.heading[piece]), jnp.sin(self.heading[piece])
        turned = self.heading[piece] + self.curvature[piece] * local
        point = self.start_mm[piece] + jnp.stack([along * cos - across * sin, along * sin + across * cos])
        return point, jnp.stack([jnp.cos(turned), jnp.sin(turned)])

    def foot(self, xyz: Float[Array, " 3"]) -> Foot:
        """Nearest point of the chain, the earlier on a tie; exact, since every piece has it in closed form."""
        k = self.curvature
        cos, sin = jnp.cos(self.heading), jnp.sin(self.heading)
        dx, dy = xyz[0] - self.start_mm[:, 0], xyz[1] - self.start_mm[:, 1]
        t, n = dx * cos + dy * sin, dy * cos - dx * sin
        bent = k != 0
        free = jnp.where(bent, jnp.arctan2(k * t, 1 - k * n) / jnp.where(bent, k, 1.0), t)
        first, last = jnp.arange(k.shape[0]) == 0, jnp.arange(k.shape[0]) == k.shape[0] - 1
        arc = jnp.clip(free, jnp.where(first, -jnp.inf, 0.0), jnp.where(last, jnp.inf, self.length_mm))
        along, across = _arc_point(arc, k)
        sq_dist = (t - along) ** 2 + (n - across) ** 2
        # R - |p - centre| without the cancellation of two large lengths; it is n itself at k = 0.
        inside = (2 * n - k * (t * t + n * n)) / (1 + jnp.sqrt((1 - k * n) ** 2 + (k * t) ** 2))
        side = (n - across) * jnp.cos(k * arc) - (t - along) * jnp.sin(k * arc)
        normal = jnp.where(arc == free, inside, side)
        turned = self.heading + k * arc
        best = jnp.argmin(sq_dist)
        tangent = jnp.stack([jnp.cos(turned[best]), jnp.sin(turned[best])])
        return Foot(self.arc_mm[best] + arc[best], normal[best], xyz[2], tangent)


def arc_chain(pieces: list[tuple[Array | float, Array | float]]) -> ArcChain:
    """Join pieces (length in mm, curvature in 1/mm) between two endless straights, centred on the origin.

    Arc length 0 is the start of the first piece. The chain is turned so that it looks along +x half-way.
    """
    lengths = jnp.stack([jnp.zeros(()), *[jnp.asarray(p[0], jnp.float32) for p in pieces], jnp.zeros(())])
    curvatures = jnp.stack([jnp.zeros(()), *[jnp.asarray(p[1], jnp.float32) for p in pieces], jnp.zeros(())])
    ends = jnp.cumsum(lengths)
    turns = jnp.cumsum(lengths * curvatures)
    headings, arcs = turns - lengths * curvatures, ends - lengths
    along, across = _arc_point(lengths, curvatures)
    cos, sin = jnp.cos(headings), jnp.sin(headings)
    steps = jnp.stack([along * cos - across * sin, along * sin + across * cos], axis=1)
    chain = ArcChain(jnp.cumsum(steps, axis=0) - steps, headings, curvatures, lengths, arcs)
    middle, tangent = chain.at(0.5 * ends[-1])
    c, s = tangent[0], tangent[1]
    rotation = jnp.stack([jnp.stack([c, s]), jnp.stack([-s, c])])
    return chain._replace(
        start_mm=(chain.start_mm - middle[None, :]) @ rotation.T, heading=headings - jnp.arctan2(s, c)
    )


class Catenary(NamedTuple):
    """A hanging cable, y = a (cosh(x/a) - 1), in the vertical plane that is z = 0 here.

    Attributes:
        parameter_mm: a, the radius of curvature at the lowest point `[]`.
        half_span_mm: Half the horizontal distance between the supports `[]`.
    """

    parameter_mm: Float[Array, ""]
    half_span_mm: Float[Array, ""]

    def _arc0(self):
        return self.parameter_mm * jnp.sinh(self.half_span_mm / self.parameter_mm)

    def at(self, arc_mm: Float[Array, ""]) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """Position `[2]` and unit tangent `[2]` at an arc length counted from the left support."""
        slope = (arc_mm - self._arc0()) / self.parameter_mm  # s = a sinh(x/a) = a tan(angle)
        secant = jnp.sqrt(1 + slope * slope)
        # a (cosh - 1) = a slope^2 / (1 + secant): no cancellation near the lowest point
        point = jnp.stack([jnp.arcsinh(slope), slope * slope / (1 + secant)]) * self.parameter_mm
        return point, jnp.stack([1 / secant, slope / secant])

    def foot(self, xyz: Float[Array, " 3"]) -> Foot:
        """Nearest point: the best of 17 places along three times the length, refined by Newton's method to rounding."""
        a = self.parameter_mm
        arc, best = jnp.zeros(()), jnp.inf
        for place in range(-8, 9):
            tried = self._arc0() * (1 + 3 * place / 8)
            point, _ = self.at(tried)
            sq_dist = (xyz[0] - point[0]) ** 2 + (xyz[1] - point[1]) ** 2
            arc, best = jnp.where(sq_dist < best, tried, arc), jnp.minimum(sq_dist, best)
        for _ in range(6):
            point, tangent = self.at(arc)
            curvature = tangent[0] ** 2 / a
            dx, dy = xyz[0] - point[0], xyz[1] - point[1]
            along, across = dx * tangent[0] + dy * tangent[1], dy * tangent[0] - dx * tangent[1]
            arc = arc + along / jnp.maximum(
                1 - curvature * across, 0.25
            )  # the guard keeps far points from overshooting
        point, tangent = self.at(arc)
        dx, dy = xyz[0] - point[0], xyz[1] - point[1]
        return Foot(arc, dy * tangent[0] - dx * tangent[1], xyz[2], tangent)


Centreline = ArcChain | Catenary
