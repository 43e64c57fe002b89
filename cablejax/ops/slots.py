"""Sums over neighbourhoods, one neighbour slot at a time, so that nothing of size n times k times 3 is made."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.varying import varying_like

Vector = tuple[Float[Array, " m"], ...]
"""Coordinates one by one: stacked in one array, each would be copied in every turn of a loop, by a kernel of its own."""

Sums = TypeVar("Sums")
State = TypeVar("State")


class Neighborhoods(NamedTuple):
    """A cloud with the neighbourhood of each point, slot by slot.

    Attributes:
        xyz: Coordinates `[3, n]`, 0 where there is no point.
        neighbors: The point itself, then its neighbours `[k + 1, n]`, -1 where there is none.
        valid: Where there is a point with finite coordinates `[n]`.
    """

    xyz: Float[Array, "3 n"]
    neighbors: Int[Array, "k n"]
    valid: Bool[Array, " n"]


def sum_over_slots(neighbors: Int[Array, "k m"], term: Callable[[Int[Array, " m"], Bool[Array, " m"]], Sums]) -> Sums:
    """Sum what `term` makes of each slot of many neighbourhoods.

    Measured on 2 cores, 53,135 neighbourhoods of 100, 28 moments of each: this loop takes 50 ms, reducing arrays of
    `[k, n]` 210 ms and products of matrices 270 ms.

    Args:
        neighbors: Rows of the neighbours `[k, m]`, -1 where there is none.
        term: From the neighbours in one slot `[m]`, 0 where there is none, and whether there is one `[m]`, to arrays.
    """

    def of(rows: Array) -> Any:
        return term(jnp.maximum(rows, 0), rows >= 0)

    shapes = jax.eval_shape(of, neighbors[0])
    start = jax.tree.map(lambda s: varying_like(jnp.zeros(s.shape, s.dtype), s), shapes)
    return through_slots(neighbors, lambda rows, sums: jax.tree.map(jnp.add, sums, of(rows)), start)


def farthest(xyz: Float[Array, "3 n"], centre: Float[Array, "3 m"], neighbors: Int[Array, "k m"]) -> Float[Array, " m"]:
    """Squared distance from each centre to its farthest neighbour; 0 where there is none."""

    def at_slot(rows: Array, most: Array) -> Array:
        sq_dist = sq_length(offsets(xyz, jnp.maximum(rows, 0), centre))
        return jnp.maximum(most, jnp.where(rows >= 0, sq_dist, 0.0))

    start = varying_like(jnp.zeros(centre.shape[1], xyz.dtype), xyz, centre, neighbors)
    return through_slots(neighbors, at_slot, start)


def through_slots(
    neighbors: Int[Array, "k m"], step: Callable[[Int[Array, " m"], State], State], start: State
) -> State:
    """Carry a state through the slots of many neighbourhoods, one after the other.

    Each slot's rows are cut out a turn before they are used. Cut out where they are used, the cut becomes part of each
    loop over the points, and LLVM does not vectorise a loop that reads the slot's number (`clean` with 100 neighbours on
    one core of an AMD EPYC: 4.6 s, so 2.2 s).

    Args:
        neighbors: Rows of the neighbours `[k, m]`, -1 where there is none.
        step: From the rows in one slot `[m]` and the state to the next state.
        start: The state before the first slot.
    """

    def turn(slot: Any, carry: tuple[Array, State]) -> tuple[Array, State]:
        rows, state = carry
        return lax.dynamic_index_in_dim(neighbors, slot + 1, keepdims=False), step(rows, state)

    return lax.fori_loop(0, neighbors.shape[0], turn, (neighbors[0], start))[1]


def gather(rows: Float[Array, "c n"], at: Int[Array, "..."]) -> Vector:
    """Columns of `rows` at given places, all of them in range, row by row."""
    return tuple(row.at[at].get(mode="promise_in_bounds", wrap_negative_indices=False) for row in rows)


def offsets(xyz: Float[Array, "3 n"], at: Int[Array, " m"], centre: Float[Array, "3 m"]) -> Vector:
    """From each centre to the point at a given place."""
    return tuple(other - own for other, own in zip(gather(xyz, at), centre, strict=True))


def sq_length(vector: Vector | Float[Array, "3 m"]) -> Float[Array, " m"]:
    """Squared lengths."""
    return along(vector, vector)


def along(axis: Vector | Float[Array, "3 m"], offset: Vector | Float[Array, "3 m"]) -> Float[Array, " m"]:
    """Products of vectors pair by pair."""
    first, *others = (a * b for a, b in zip(axis, offset, strict=True))
    for each in others:
        first = first + each
    return first
