"""The types every part of cablejax shares: a padded cloud, and status bits worded for people."""

import enum
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from cablejax.jax_sums import warn_where_wrong
from cablejax.programs import make_room

warn_where_wrong()  # every part imports this module before it computes

# float32 may move a point by so much of the cloud's width: a cable 400 mm long by 4 um.
LARGEST_ROUNDING = 1e-5

_MET: set[int] = set()  # capacities whose programs have found room


def capacity_for(n: int) -> int:
    """The least capacity that holds n points among eight sizes an octave.

    Every new shape is compiled anew; with these, clouds of any size between 1,000 and 1,000,000 points need some 80 programs
    and less than an eighth of padding.

    Example:
        >>> [capacity_for(n) for n in (0, 7, 9, 1000, 1025, 53_135)]
        [1, 7, 9, 1024, 1152, 53248]
    """
    step = 1 << max(0, (n - 1).bit_length() - 4)
    return max(1, -(-n // step) * step)


class PointCloud(NamedTuple):
    """Points with their validity: the fixed-shape form in which jit-compiled functions take a cloud.

    Rows whose mask is False are padding: whatever coordinates stand there, and however many they are, they change no valid
    output.

    Attributes:
        xyz: Coordinates `[n, 3]`, float32.
        mask: True where a row is a point `[n]`.
    """

    xyz: Float[Array, "n 3"]
    mask: Bool[Array, " n"]

    @classmethod
    def from_xyz(cls, xyz: ArrayLike, *, capacity: int | None = None) -> "PointCloud":
        """Wrap coordinates `[n, 3]`, padded with invalid rows up to `capacity`.

        Unless told otherwise the cloud takes one of a few capacities, so that clouds of many sizes share the programs that
        jax compiles for each shape: a loop over a thousand scans of different sizes compiles some thirty, not a thousand.

        Args:
            xyz: Coordinates, rounded to float32. What float32 would spoil, such as map coordinates in metres, is
                refused; coordinates that are float32 already, or traced by jax, are taken as they are.
            capacity: Rows of the cloud; `capacity_for(n)` if None, and `capacity=n` for no padding.

        Raises:
            ValueError: If `xyz` is not `[n, 3]`, does not fit into `capacity`, or lies so far from the origin that float32
                would move a point by more than 1e-5 of the cloud's width.

        Example:
            >>> PointCloud.from_xyz([[0.0, 0.0, 0.0]], capacity=3).mask.tolist()
            [True, False, False]
        """
        on_device = isinstance(xyz, jax.Array)
        if not on_device:
            xyz = np.asarray(xyz)
            _check_rounding(xyz)
        # Arrays of the host are padded there: on the device each number of points would compile its own padding.
        points = jnp.asarray(xyz, dtype=jnp.float32) if on_device else np.asarray(xyz, dtype=np.float32)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"xyz: expected shape [n, 3], got {list(points.shape)}")
        n = points.shape[0]
        rows = capacity_for(n) if capacity is None else capacity
        if rows < n:
            raise ValueError(f"capacity: expected at least the number of points, {n}, got {capacity}")
        if not isinstance(xyz, Tracer):
            _room_for(rows)
        padded = (jnp if on_device else np).pad(points, ((0, rows - n), (0, 0)))
        return cls(jnp.asarray(padded), jnp.asarray(np.arange(rows) < n))


def _room_for(rows: int) -> None:
    """See to it, once for each capacity, that its programs find room beside those of others."""
    if rows not in _MET:
        if make_room():
            _MET.clear()
        _MET.add(rows)


def _check_rounding(xyz: np.ndarray) -> None:
    """Refuse coordinates `[n, 3]` that lose their differences in float32."""
    if xyz.ndim != 2 or xyz.dtype == np.float32 or not len(xyz):
        return
    wide = xyz.astype(np.float64)
    finite = wide[np.isfinite(wide).all(axis=1)]
    if not len(finite):
        return
    width = float(np.ptp(finite, axis=0).max())
    with np.errstate(over="ignore"):
        moved = float(np.abs(finite.astype(np.float32).astype(np.float64) - finite).max())
    if width > 0 and moved > LARGEST_ROUNDING * width:
        raise ValueError(
            f"xyz: expected coordinates near the origin, got a cloud {width:.3g} wide about "
            f"{float(np.abs(finite).max()):.3g} from it, whose points float32 would move by up to {moved:.2g}; subtract a "
            "shift first: xyz - np.median(xyz, axis=0)"
        )


class Status(enum.IntFlag):
    """What a kernel has to say about its result; bits are or-ed inside jit and returned as int32.

    Kernels cannot raise on values under `jit`, so they report. Callers on the outside (experiments, the command line)
    turn bits into errors with `raise_on`.
    """

    OK = 0
    TOO_FEW_NEIGHBORS = 1
    CAPACITY_EXCEEDED = 2
    NOT_CONVERGED = 4
    NOT_FINITE = 8
    DEGENERATE = 16
    EMPTY = 32
    LOWER_ORDER = 64
    INVALID = 128


STATUS_TEXT: Mapping[Status, str] = MappingProxyType(
    {
        Status.TOO_FEW_NEIGHBORS: "some points have fewer neighbours than asked for",
        Status.CAPACITY_EXCEEDED: "a fixed capacity was too small and the result is incomplete",
        Status.NOT_CONVERGED: "the iteration stopped before it converged",
        Status.NOT_FINITE: "the input or the result holds NaN or infinite values",
        Status.DEGENERATE: "the geometry leaves the answer undetermined",
        Status.EMPTY: "the cloud holds no valid point",
        Status.LOWER_ORDER: "the neighbours of some points do not determine the surface asked for, so a simpler one was taken",
        Status.INVALID: "an argument has a value that nothing can be computed with, so nothing was",
    }
)


def describe(status: ArrayLike | int) -> list[str]:
    """Say in words what the bits of a status mean; an array of statuses is or-ed together first.

    Example:
        >>> describe(Status.EMPTY | Status.NOT_CONVERGED)
        ['the iteration stopped before it converged', 'the cloud holds no valid point']
    """
    bits = jnp.asarray(status, dtype=jnp.int32).reshape(-1)
    return [text for bit, text in STATUS_TEXT.items() if bool((bits & int(bit)).any())]


class StatusError(RuntimeError):
    """A kernel's status held a bit that the caller does not accept."""


def raise_on(status: ArrayLike | int, *, what: str, ignore: Status = Status.OK) -> None:
    """Raise `StatusError` if the status holds any bit outside `ignore`.

    Args:
        status: A kernel's status, scalar or per point.
        what: What was being done, for the message: "outlier removal of scan.ply".
        ignore: Bits that the caller accepts.

    Raises:
        StatusError: Naming `what` and every bit left, in words.
    """
    left = describe(jnp.asarray(status, dtype=jnp.int32) & ~int(ignore))
    if left:
        raise StatusError(f"{what}: {'; '.join(left)}")
