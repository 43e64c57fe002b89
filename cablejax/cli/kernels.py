"""The kernels that commands run on whole clouds, traced once on a machine."""

from functools import partial

import jax
from jaxtyping import Array, Bool, Float

from cablejax.ops import clean, statistical_outliers
from cablejax.traces import Traced
from cablejax.types import PointCloud


@Traced
@partial(jax.jit, static_argnames=("k", "order"))
def cleaned(
    cloud: PointCloud, std_ratio: Float[Array, ""], *, k: int, order: int
) -> tuple[Float[Array, "n 3"], Bool[Array, " n"], Float[Array, " n"]]:
    """`clean`: points, which of them are kept, and kernel widths."""
    result = clean(cloud, std_ratio=std_ratio, k=k, order=order)
    return result.xyz, result.keep, result.width


@Traced
@jax.jit
def without_outliers(cloud: PointCloud, std_ratio: Float[Array, ""]) -> Bool[Array, " n"]:
    """`statistical_outliers`: which points are kept."""
    return statistical_outliers(cloud, std_ratio=std_ratio).keep
