"""What every search is asked: points, queries, who counts and who does not; checked once."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.neighbors.metric import wrap
from cablejax.ops.neighbors.segments import build_segments, segments_of, with_segment
from cablejax.ops.neighbors.tree import Tree, build
from cablejax.types import Status

BRUTE_POINTS = 2048  # up to here comparing all pairs costs about as little as a tree, which takes seconds to compile
AXES = 3  # up to so many a tree serves; beyond, boxes meet almost everything and all pairs are compared


class Points(NamedTuple):
    """One side of a search, its defaults filled in; gradients stopped.

    Attributes:
        xyz: Coordinates `[n, c]` float32, within the box if there is one, zeros where not usable.
        asked: True where a row is no padding `[n]`.
        finite: True where its coordinates are finite `[n]`.
        segment: Cloud of each row of a ragged batch `[n]` int32, -1 for padding; one cloud if None.
        box: Lengths of the periodic box `[c]`, inf where it does not close; none if None.
        good: False where row splits or box have values that nothing can be done with; not said if None.
    """

    xyz: Float[Array, "n c"]
    asked: Bool[Array, " n"]
    finite: Bool[Array, " n"]
    segment: Int[Array, " n"] | None = None
    box: Float[Array, " c"] | None = None
    good: Bool[Array, ""] | None = None

    def usable(self) -> Bool[Array, " n"]:
        """Rows that can be found and can ask."""
        usable = self.asked & self.finite
        return usable if self.good is None else usable & self.good

    def has_tree(self) -> bool:
        """Whether a tree serves; all pairs are compared if not."""
        return self.xyz.shape[1] <= AXES and self.xyz.shape[0] > BRUTE_POINTS

    def tree(self) -> Tree:
        """The rows as a tree."""
        xyz = in_space(self.xyz)
        tree = build(xyz, self.usable()) if self.segment is None else build_segments(xyz, self.usable(), self.segment)
        return tree if self.box is None else tree._replace(box=self.lengths(tree.xyz.shape[0]))

    def columns(self) -> Float[Array, "n c1"]:
        """Coordinates as all pairs are compared: with the further axis of a ragged batch."""
        return self.xyz if self.segment is None else with_segment(self.xyz, self.segment)

    def lengths(self, axes: int) -> Float[Array, " axes"] | None:
        """The box with axes that do not close for those that it says nothing of."""
        return None if self.box is None else jnp.pad(self.box, (0, axes - self.box.shape[0]), constant_values=jnp.inf)

    def status(self) -> Int[Array, " n"]:
        """NOT_FINITE and INVALID where they apply; zero on padding."""
        status = bit(self.asked & ~self.finite, Status.NOT_FINITE)
        return status if self.good is None else status | bit(self.asked & ~self.good, Status.INVALID)


def prepare(
    xyz: Array,
    mask: Array | None = None,
    row_splits: Array | None = None,
    box: Array | None = None,
    name: str = "xyz",
) -> Points:
    """Check one side of a search and fill in its defaults.

    Raises:
        ValueError: If the shapes do not fit together, or coordinates are no floats of at most 32 bits.
    """
    if xyz.ndim != 2 or xyz.shape[0] < 1 or xyz.shape[1] < 1:
        raise ValueError(f"{name}: expected shape [n, c] with n and c at least 1, got {list(xyz.shape)}")
    n, c = xyz.shape
    if mask is not None and mask.shape != (n,):
        raise ValueError(f"mask: expected shape [{n}], got {list(mask.shape)}")
    if box is not None and box.shape != (c,):
        raise ValueError(f"box: expected one length per axis, shape [{c}], got {list(box.shape)}")
    if row_splits is not None and (row_splits.ndim != 1 or row_splits.shape[0] < 2):
        raise ValueError(f"row_splits: expected shape [b + 1] for b clouds, got {list(row_splits.shape)}")
    asked, good, segment = jnp.ones(n, dtype=bool) if mask is None else mask, None, None
    xyz = jax.lax.stop_gradient(as_float32(xyz, name))
    finite = jnp.isfinite(xyz).all(axis=1)
    if box is not None:
        box = jax.lax.stop_gradient(jnp.asarray(box, dtype=jnp.float32))
        good = jnp.all(box > 0)
        box = jnp.where(good, box, jnp.inf)
    if row_splits is not None:
        segment, ascending = segments_of(row_splits, n)
        # Rows of no cloud are padding; splits that do not ascend leave none that is one, and all rows say so.
        asked = asked & ((segment >= 0) | ~ascending)
        good = ascending if good is None else good & ascending
    usable = asked & finite
    return Points(wrap(jnp.where(usable[:, None], xyz, 0.0), box), asked, finite, segment, box, good)


def as_float32(xyz: Array, name: str) -> Float[Array, "..."]:
    """Coordinates as the kernels compute with them.

    Raises:
        ValueError: If they would lose digits: float64, and integers.
    """
    if xyz.dtype in (jnp.float32, jnp.float16, jnp.bfloat16):
        return xyz.astype(jnp.float32)
    raise ValueError(
        f"{name}: expected float32 coordinates (or float16, bfloat16), got {xyz.dtype}; "
        f"shift them near the origin, then cast: ({name} - {name}.mean(axis=0)).astype(float32)"
    )


def bit(condition: Bool[Array, "*n"], status: Status) -> Int[Array, "*n"]:
    """A status where a condition holds, 0 elsewhere."""
    return jnp.where(condition, jnp.int32(int(status)), jnp.int32(0))


def in_space(xyz: Float[Array, "n c"]) -> Float[Array, "n 3"]:
    """Points on a line or a plane as points in space: distances stay, to the last bit."""
    return jnp.pad(xyz, ((0, 0), (0, AXES - xyz.shape[1])))
