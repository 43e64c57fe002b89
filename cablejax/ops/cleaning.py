"""Outlier removal and the adaptive filter on one neighbour search."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.filters import adaptive_filter
from cablejax.ops.neighbors import ListAndSums, neighbors_and_sums
from cablejax.ops.outliers import removal_by_sums
from cablejax.ops.precision import require_float32
from cablejax.types import PointCloud


class CleanResult(NamedTuple):
    """A cloud without its outliers, smoothed.

    Attributes:
        xyz: Points `[n, 3]`, filtered where kept, as they came elsewhere.
        keep: True where a point is no outlier `[n]`; False on padding.
        width: Kernel width of each point `[n]`, in the cloud's unit; 0 where nothing was filtered.
        status: `Status` bits of each point `[n]` int32.
    """

    xyz: Float[Array, "n 3"]
    keep: Bool[Array, " n"]
    width: Float[Array, " n"]
    status: Int[Array, " n"]


def clean(
    cloud: PointCloud,
    *,
    removal_k: int = 20,
    std_ratio: float | Float[Array, ""] = 2.0,
    k: int = 100,
    alpha: float | Float[Array, ""] | None = None,
    beta: float | Float[Array, ""] | None = None,
    gamma: float | Float[Array, ""] | None = None,
    tau: float | Float[Array, ""] | None = None,
    order: int = 2,
    form: str = "linear",
    iterations: int = 1,
    refinements: int = 1,
    crowding: float | Float[Array, ""] | None = None,
) -> CleanResult:
    """Drop outliers as `statistical_outliers` does, then smooth the rest as `adaptive_filter` does, with one search.

    The filter's neighbours are the kept ones among the k nearest of the whole cloud, so those of a point next to outliers
    are fewer; after a removal and a search of its own they would be k again. Order 0 is the paper's method as a whole.
    Two programs are compiled, the search with the removal and the filter.

    Args:
        cloud: Points `[n, 3]`, any unit, with validity `[n]`.
        removal_k: Neighbours of the removal, the point itself counted. Static.
        std_ratio: Standard deviations above the mean at which a point is dropped.
        k: Neighbours of the filter, the point itself not counted. Static.
        alpha: As the rest, of `adaptive_filter`.
        beta: See there.
        gamma: See there.
        tau: See there.
        order: See there. Static.
        form: See there. Static.
        iterations: See there. Static.
        refinements: See there. Static.
        crowding: See there.

    Returns:
        Filtered points, which of them are kept, widths and status.

    Raises:
        ValueError: As `statistical_outliers` (its `k` is `removal_k`) and `adaptive_filter` do.

    Example:
        >>> line = jnp.stack([jnp.arange(40.0), jnp.zeros(40), jnp.zeros(40)], axis=1).at[7, 2].set(30.0)
        >>> result = clean(PointCloud.from_xyz(line), removal_k=4, k=6, order=0)
        >>> int(result.keep.sum()), bool(result.keep[7])
        (39, False)
    """
    require_float32(cloud__xyz=cloud.xyz)
    if removal_k < 2:
        raise ValueError(f"removal_k: expected at least 2 (the point itself counts), got {removal_k}")
    if k < 1:
        raise ValueError(f"k: expected at least 1, got {k}")
    search, keep = _removal(cloud, jnp.asarray(std_ratio, dtype=jnp.float32), removal_k=removal_k, k=k)
    smooth = adaptive_filter(
        PointCloud(cloud.xyz, keep), k=k, alpha=alpha, beta=beta, gamma=gamma, tau=tau, order=order, form=form,
        iterations=iterations, refinements=refinements, crowding=crowding, found=search,
    )  # fmt: skip
    return CleanResult(smooth.xyz, keep, smooth.width, smooth.status)


@partial(jax.jit, static_argnames=("removal_k", "k"))
def _removal(
    cloud: PointCloud, std_ratio: Float[Array, ""], *, removal_k: int, k: int
) -> tuple[ListAndSums, Bool[Array, " n"]]:
    """The one search, and what `statistical_outliers` keeps."""
    search = neighbors_and_sums(cloud.xyz, k=k, total_k=removal_k - 1, mask=cloud.mask)
    return search, removal_by_sums(cloud, search.total, search.count, search.total_status, std_ratio).keep
