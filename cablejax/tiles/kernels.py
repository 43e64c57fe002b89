"""What is computed in each tile, compiled once for all of them."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jaxtyping import Array, Float

from cablejax import ops
from cablejax.ops import KnnResult, Trial, adaptive_filter, knn, statistical_outliers
from cablejax.ops.slots import through_slots
from cablejax.traces import Traced
from cablejax.types import PointCloud


class Smoothed(NamedTuple):
    """A filtered tile.

    Attributes:
        xyz: `[capacity, 3]`.
        width: Kernel width `[capacity]`.
        need: Distance within which a point's result depends on others `[capacity]`.
    """

    xyz: Float[Array, "m 3"]
    width: Float[Array, " m"]
    need: Float[Array, " m"]


for kind in (PointCloud, Trial, Smoothed):
    export.register_namedtuple_serialization(kind, serialized_name=f"cablejax.{kind.__name__}")
width_trial = Traced(ops.width_trial)


def padded(xyz: Float[np.ndarray, "m 3"], capacity: int) -> PointCloud:
    """A tile in the one shape that all tiles have."""
    return PointCloud.from_xyz(xyz, capacity=capacity)


@Traced
@partial(jax.jit, static_argnames=("removal_k",))
def scores(cloud: PointCloud, *, removal_k: int) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """The score of each point in `statistical_outliers` and the distance of the last neighbour that it rests on."""
    found = knn(cloud.xyz, k=removal_k - 1, mask=cloud.mask)
    score = statistical_outliers(cloud, k=removal_k, found=found).score
    return score, _reach(found)


@Traced
@partial(jax.jit, static_argnames=("k", "order", "refinements"))
def smooth(
    cloud: PointCloud, keep: Array, alpha: Array, usual: Array, *, k: int, order: int, refinements: int
) -> Smoothed:
    """The adaptive filter on the kept points of a tile, with the search over all of them, as `clean` does it."""
    found = knn(cloud.xyz, k=k, mask=cloud.mask)
    kept = PointCloud(cloud.xyz, keep)
    result = adaptive_filter(
        kept, k=k, alpha=alpha, usual_noise=usual, order=order, refinements=refinements, found=found
    )
    need = reach = _reach(found)
    near = found.neighbors.T
    for _ in range(refinements if order else 0):
        need = reach + _farthest(near, keep, need)
    return Smoothed(result.xyz, result.width, need)


def _farthest(near: Array, keep: Array, need: Array) -> Array:
    """The largest need among each point's kept neighbours."""

    def at_slot(rows, most):
        return jnp.maximum(most, jnp.where((rows >= 0) & keep[jnp.maximum(rows, 0)], need[jnp.maximum(rows, 0)], 0.0))

    return through_slots(near, at_slot, jnp.zeros_like(need))


@Traced
@partial(jax.jit, static_argnames=("removal_k",))
def nearest(cloud: PointCloud, queries: Float[Array, "q 3"], *, removal_k: int) -> Float[Array, "q k"]:
    """Squared distances of queries to their nearest points in a tile, inf where it holds fewer."""
    return knn(cloud.xyz, k=removal_k, queries=queries, mask=cloud.mask).sq_dist


def _reach(found: KnnResult) -> Float[Array, " m"]:
    return jnp.sqrt(found.sq_dist[:, -1])
