"""Steps under jit, for as long as the correspondences are certain: each source point carries its nearest target points along."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.registration.gauss_newton import Kernel, Method, Pairs, Step, icp_step

AHEAD = 2.0  # the tree is also asked for what would be in doubt after as long a way again: fewer, larger questions
_PRECISION = jax.lax.Precision.HIGHEST


class Carried(NamedTuple):
    """Source points with the target points that were nearest where the tree was asked.

    Attributes:
        source, source_normal: Points and unit normals `[3, n]` in the source's frame.
        near, near_normal: The `k` nearest target points and their normals `[k, 3, n]`; 1e9 where there are fewer.
        asked: Where each point was when the tree was asked `[3, n]`.
        bound: No other target point is nearer to `asked` than this `[n]`; inf if there is none.
        valid: False on padding `[n]`.
    """

    source: Float[Array, "3 n"]
    source_normal: Float[Array, "3 n"]
    near: Float[Array, "k 3 n"]
    near_normal: Float[Array, "k 3 n"]
    asked: Float[Array, "3 n"]
    bound: Float[Array, " n"]
    valid: Bool[Array, " n"]


class Limits(NamedTuple):
    """When to pair, to stop and to leave a direction alone: `max_distance`, `least_move`, `least_share`, steps that are left."""

    max_distance: Float[Array, ""]
    least_move: Float[Array, ""]
    least_share: Float[Array, ""]
    steps: Int[Array, ""]


class State(NamedTuple):
    """Where the steps have come to.

    Attributes:
        T_target_source: The motion.
        step: The last step made.
        done: Number of steps made.
        small: Whether the last one moved the points by less than `least_move`.
        doubtful: Whether some point's correspondence is not certain at this motion.
    """

    T_target_source: Float[Array, "4 4"]
    step: Step
    done: Int[Array, ""]
    small: Bool[Array, ""]
    doubtful: Bool[Array, ""]


def _moved(carried: Carried, T: Float[Array, "4 4"]) -> Float[Array, "3 n"]:
    return jnp.matmul(T[:3, :3], carried.source, precision=_PRECISION) + T[:3, 3:]


def _nearest(carried: Carried, moved: Float[Array, "3 n"]) -> tuple[Array, Array, Array]:
    """Squared distance, corresponding point and its normal among the points carried; the earlier one where two are as near."""
    best, target, normal = None, carried.near[0], carried.near_normal[0]
    for point, direction in zip(carried.near, carried.near_normal, strict=True):
        sq = jnp.sum((point - moved) ** 2, axis=0)
        closer = sq < (jnp.inf if best is None else best)
        best = jnp.where(closer, sq, jnp.inf if best is None else best)
        target, normal = jnp.where(closer[None], point, target), jnp.where(closer[None], direction, normal)
    assert best is not None
    return best, target, normal


def _doubt(carried: Carried, moved: Array, sq: Array, max_distance: Array, ahead: float = 1.0) -> Bool[Array, " n"]:
    """Where another target point may be nearer by now: the nearest carried one is no longer within what is known.

    What is further than `max_distance` needs no correspondence, so it is enough to know that nothing is nearer than that.
    """
    gone = jnp.sqrt(jnp.sum((moved - carried.asked) ** 2, axis=0))
    return carried.valid & (jnp.minimum(jnp.sqrt(sq), max_distance) > carried.bound - ahead * gone)


@jax.jit
def doubtful(
    carried: Carried, T_target_source: Float[Array, "4 4"], max_distance: Float[Array, ""]
) -> Bool[Array, " n"]:
    """Points `[n]` whose correspondence is not certain at a motion."""
    moved = _moved(carried, T_target_source)
    return _doubt(carried, moved, _nearest(carried, moved)[0], max_distance, AHEAD)


def _orthonormal(T: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """One step of Newton's iteration to the nearest rotation: float32 products drift by a rounding a step."""
    rotation = T[:3, :3]
    square = jnp.matmul(rotation.T, rotation, precision=_PRECISION)
    return T.at[:3, :3].set(jnp.matmul(rotation, 1.5 * jnp.eye(3) - 0.5 * square, precision=_PRECISION))


@partial(jax.jit, static_argnames=("method", "kernel"))
def steps(
    carried: Carried, T_target_source: Float[Array, "4 4"], limits: Limits, *, method: Method, kernel: Kernel
) -> State:
    """Step until the motion is small, the steps are spent, fewer than six pairs are left, or a correspondence is in doubt.

    The correspondences are certain at the first step: the tree has just been asked there.
    """

    def once(state: State) -> State:
        T = state.T_target_source
        moved = _moved(carried, T)
        sq, target, normal = _nearest(carried, moved)
        doubt = (state.done > 0) & _doubt(carried, moved, sq, limits.max_distance).any()

        def ask_first() -> State:
            return state._replace(small=jnp.bool_(False), doubtful=jnp.bool_(True))

        def make() -> State:
            turned = jnp.matmul(T[:3, :3], carried.source_normal, precision=_PRECISION)
            weight = (carried.valid & (sq <= limits.max_distance**2)).astype(jnp.float32)
            pairs = Pairs(moved, turned, target, normal, weight)
            step = icp_step(pairs, T, limits.least_share, method=method, kernel=kernel)
            enough = step.inliers >= 6
            # Near its end a loop may go round among a few correspondences as good as each other: the pairs fit no better.
            around = (
                (step.moved < 10 * limits.least_move) & (step.rmse >= state.step.rmse * (1 - 1e-6)) & (state.done > 0)
            )
            small = enough & ((step.moved < limits.least_move) | around)
            now = jnp.where(enough, _orthonormal(step.T_target_source), T)
            return State(now, step, state.done + 1, small, jnp.bool_(False))

        return jax.lax.cond(doubt, ask_first, make)

    def goes_on(state: State) -> Array:
        enough = (state.done == 0) | (state.step.inliers >= 6)
        return ~state.small & ~state.doubtful & enough & (state.done < limits.steps)

    zero, none = jnp.float32(0), jnp.zeros(6)
    blank = Step(
        T_target_source=T_target_source,
        moved=zero,
        rmse=zero,
        inliers=zero,
        covariance=jnp.zeros((6, 6)),
        observability=none,
        directions=jnp.zeros((6, 6)),
        seen=none > 0,
        center=jnp.zeros(3),
    )
    start = State(T_target_source, blank, jnp.int32(0), jnp.bool_(False), jnp.bool_(False))
    return jax.lax.while_loop(goes_on, once, start)
