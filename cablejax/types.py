"""The types every part of cablejax shares: a padded cloud, and status bits worded for people."""

import enum
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike


class PointCloud(NamedTuple):
    """Points with their validity: the fixed-shape form in which jit-compiled functions take a cloud.

    Rows whose mask is False are padding: whatever coordinates stand there, they change no valid output.

    Attributes:
        xyz: Coordinates `[n, 3]`, float32.
        mask: True where a row is a point `[n]`.
    """

    xyz: Float[Array, "n 3"]
    mask: Bool[Array, " n"]

    @classmethod
    def from_xyz(cls, xyz: ArrayLike, *, capacity: int | None = None) -> "PointCloud":
        """Wrap coordinates `[n, 3]`, padded with invalid rows up to `capacity`.

        Raises:
            ValueError: If `xyz` is not `[n, 3]` or does not fit into `capacity`.

        Example:
            >>> PointCloud.from_xyz([[0.0, 0.0, 0.0]], capacity=3).mask.tolist()
            [True, False, False]
        """
        points = jnp.asarray(xyz, dtype=jnp.float32)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"xyz: expected shape [n, 3], got {list(points.shape)}")
        n = points.shape[0]
        capacity = n if capacity is None else capacity
        if capacity < n:
            raise ValueError(f"capacity: expected at least the number of points, {n}, got {capacity}")
        return cls(jnp.pad(points, ((0, capacity - n), (0, 0))), jnp.arange(capacity) < n)


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


STATUS_TEXT: Mapping[Status, str] = MappingProxyType(
    {
        Status.TOO_FEW_NEIGHBORS: "some points have fewer neighbours than asked for",
        Status.CAPACITY_EXCEEDED: "a fixed capacity was too small and the result is incomplete",
        Status.NOT_CONVERGED: "the iteration stopped before it converged",
        Status.NOT_FINITE: "the input or the result holds NaN or infinite values",
        Status.DEGENERATE: "the geometry leaves the answer undetermined",
        Status.EMPTY: "the cloud holds no valid point",
        Status.LOWER_ORDER: "the neighbours of some points do not determine the surface asked for, so a simpler one was taken",
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
