"""Centrelines of cables: plane curves that know the nearest of their points to any point in space."""

from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


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


class _Near(NamedTuple):
    """A query beside one piece of a chain, in the frame of the piece's start.

    Attributes:
        sq_dist: Squared distance within the plane, of the piece's start where the foot is not on the piece `[]`.
        beside: Whether the foot is on the piece `[]`.
        t: Place along the piece's heading `[]`.
        offset: Signed distance to the piece's line or circle `[]`.
        u, v: 1 - k n and k t: the query seen from the centre of curvature, in radii `[]`.
        norm: Its length `[]`.
    """

    sq_dist: Float[Array, ""]
    beside: Bool[Array, ""]
    t: Float[Array, ""]
    offset: Float[Array, ""]
    u: Float[Array, ""]
    v: Float[Array, ""]
    norm: Float[Array, ""]


class ArcChain(NamedTuple):
    """Straight and circular pieces joined with a common tangent; the first and the last are straight and endless.

    Attributes:
        start_mm: Start of each piece `[k, 2]`.
        heading: Direction of each piece at its start, radians `[k]`.
        curvature: Signed curvature of each piece, 1/mm `[k]`, 0 in the first and the last.
        length_mm: Length of each piece `[k]`.
        arc_mm: Arc length at the start of each piece `[k]`.
        axis: Cosine and sine of each heading `[k, 2]`.
        end: How far each piece reaches along its heading, in mm, and the cosine of its turn `[k, 2]`.
    """

    start_mm: Float[Array, "k 2"]
    heading: Float[Array, " k"]
    curvature: Float[Array, " k"]
    length_mm: Float[Array, " k"]
    arc_mm: Float[Array, " k"]
    axis: Float[Array, "k 2"]
    end: Float[Array, "k 2"]

    def at(self, arc_mm: Float[Array, ""]) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """Position `[2]` and unit tangent `[2]` at an arc length."""
        piece = jnp.clip(jnp.sum(arc_mm >= self.arc_mm) - 1, 0)
        local = arc_mm - self.arc_mm[piece]
        along, across = _arc_point(local, self.curvature[piece])
        cos, sin = self.axis[piece, 0], self.axis[piece, 1]
        turned = self.heading[piece] + self.curvature[piece] * local
        point = self.start_mm[piece] + jnp.stack([along * cos - across * sin, along * sin + across * cos])
        return point, jnp.stack([jnp.cos(turned), jnp.sin(turned)])

    def _pieces(self, xyz: Float[Array, " 3"]) -> list[_Near]:
        """The query beside every piece. The pieces are written out one by one: a beam a vector lane, no small axes."""
        last = self.curvature.shape[0] - 1
        found = []
        for i in range(last + 1):
            k, (cos, sin) = self.curvature[i], self.axis[i]
            dx, dy = xyz[0] - self.start_mm[i, 0], xyz[1] - self.start_mm[i, 1]
            t, n = dx * cos + dy * sin, dy * cos - dx * sin
            u, v = 1 - k * n, k * t
            norm = jnp.sqrt(u * u + v * v)
            # R - |p - centre| without the cancellation of two large lengths; it is n itself at k = 0
            offset = (2 * n - k * (t * t + n * n)) / (1 + norm)
            # the foot lies on the piece if the query, seen from the centre, lies between the rays through its ends
            from_start, to_end = t >= 0, u * self.end[i, 0] >= t * self.end[i, 1]
            wide = jnp.abs(k) * self.length_mm[i] > jnp.pi
            beside = jnp.where(wide, from_start | to_end, from_start & to_end)
            beside = ~from_start if i == 0 else from_start if i == last else beside
            # beside no piece: rounding at a joint, whose distance every piece brings along
            sq_dist = jnp.where(beside, offset * offset, dx * dx + dy * dy)
            found.append(_Near(sq_dist, beside, t, offset, u, v, norm))
        return found

    def sq_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Squared distance to the chain within the plane z = 0; no trigonometry, for it is asked at every step of a beam."""
        sq_dists = [near.sq_dist for near in self._pieces(xyz)]
        return reduce(jnp.minimum, sq_dists)

    def foot(self, xyz: Float[Array, " 3"]) -> Foot:
        """Nearest point of the chain, the earlier on a tie; exact, since every piece has it in closed form."""
        pieces = self._pieces(xyz)
        best, chosen = pieces[0], [self.curvature[0], self.arc_mm[0], *self.axis[0]]
        for i, near in enumerate(pieces[1:], 1):
            nearer = near.sq_dist < best.sq_dist
            best = _Near(*(jnp.where(nearer, new, old) for new, old in zip(near, best, strict=True)))
            mine = [self.curvature[i], self.arc_mm[i], *self.axis[i]]
            chosen = [jnp.where(nearer, new, old) for new, old in zip(mine, chosen, strict=True)]
        k, start, cos, sin = chosen
        bent, whole = best.beside & (k != 0), best.beside & (best.norm > 0)
        turn = jnp.arctan2(jnp.where(bent, best.v, 0.0), jnp.where(bent, best.u, 1.0))
        local = jnp.where(bent, turn / jnp.where(bent, k, 1.0), jnp.where(best.beside, best.t, 0.0))
        over = jnp.where(whole, best.norm, 1.0)
        u, v = jnp.where(whole, best.u, 1.0) / over, jnp.where(whole, best.v, 0.0) / over
        tangent = jnp.stack([cos * u - sin * v, sin * u + cos * v])
        return Foot(start + local, best.offset, xyz[2], tangent)

    def parallel(self, across_mm: Float[Array, ""]) -> "ArcChain":
        """The chain at a constant offset along the normal: the same turns, bends tighter or wider by the offset."""
        scale = 1 - self.curvature * across_mm
        normal = jnp.stack([-self.axis[:, 1], self.axis[:, 0]], axis=1)
        longer = (scale - 1) * self.length_mm
        return ArcChain(
            self.start_mm + across_mm * normal,
            self.heading,
            self.curvature / scale,
            self.length_mm * scale,
            self.arc_mm + jnp.cumsum(longer) - longer,
            self.axis,
            jnp.stack([self.end[:, 0] * scale, self.end[:, 1]], axis=1),
        )


@partial(jax.jit, inline=True)  # one program where no other is being traced, and no trace of it in one that is
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
    turn = jnp.abs(curvatures) * lengths
    reach = jnp.stack([lengths * jnp.sinc(turn / jnp.pi), jnp.cos(turn)], axis=1)
    axes = jnp.stack([cos, sin], axis=1)
    chain = ArcChain(jnp.cumsum(steps, axis=0) - steps, headings, curvatures, lengths, arcs, axes, reach)
    middle, tangent = chain.at(0.5 * ends[-1])
    c, s = tangent[0], tangent[1]
    rotation = jnp.stack([jnp.stack([c, s]), jnp.stack([-s, c])])
    headings = headings - jnp.arctan2(s, c)
    return chain._replace(
        start_mm=(chain.start_mm - middle[None, :]) @ rotation.T,
        heading=headings,
        axis=jnp.stack([jnp.cos(headings), jnp.sin(headings)], axis=1),
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

    def sq_distance(self, xyz: Float[Array, " 3"]) -> Float[Array, ""]:
        """Squared distance to the curve within the plane z = 0."""
        return self.foot(xyz).normal_mm ** 2

    def foot(self, xyz: Float[Array, " 3"]) -> Foot:
        """Nearest point: the best of 17 places along three times the length, refined by Newton's method to rounding."""
        places = self._arc0() * (1 + 3 * jnp.arange(-8, 9) / 8)
        points = jax.vmap(lambda arc: self.at(arc)[0])(places)
        sq_dists = (xyz[0] - points[:, 0]) ** 2 + (xyz[1] - points[:, 1]) ** 2

        def newton(_, arc):
            point, tangent = self.at(arc)
            dx, dy = xyz[0] - point[0], xyz[1] - point[1]
            along, across = dx * tangent[0] + dy * tangent[1], dy * tangent[0] - dx * tangent[1]
            # the guard keeps far points from overshooting
            return arc + along / jnp.maximum(1 - tangent[0] ** 2 / self.parameter_mm * across, 0.25)

        arc = jax.lax.fori_loop(0, 6, newton, places[jnp.argmin(sq_dists)])
        point, tangent = self.at(arc)
        dx, dy = xyz[0] - point[0], xyz[1] - point[1]
        return Foot(arc, dy * tangent[0] - dx * tangent[1], xyz[2], tangent)


Centreline = ArcChain | Catenary
