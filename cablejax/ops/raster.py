"""A differentiable raster of point features on a cylinder's surface: points to grid, grid to points."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class RasterTaps(NamedTuple):
    """Where each point falls on the grid: its four cells and their bilinear shares.

    Attributes:
        cells: Flat cell numbers `[n, 4]`, row-major over (axial, angular).
        shares: Weights `[n, 4]` that sum to 1; all 0 on padding and on points outside the grid.
    """

    cells: Int[Array, "n 4"]
    shares: Float[Array, "n 4"]


def raster_taps(
    axial: Float[Array, " n"],
    angle: Float[Array, " n"],
    mask: Bool[Array, " n"] | None = None,
    *,
    shape: tuple[int, int],
    half_length: float,
) -> RasterTaps:
    """Bilinear cells and shares of points on a grid over `[-half_length, half_length]` x the full turn.

    Cell centres lie at the middle of each cell; the grid is closed in angle and open along the axis, where the outer
    half of the last cells belongs to them alone.

    Args:
        axial: Position along the axis `[n]`, in the unit of `half_length`.
        angle: Angle in radians `[n]`.
        mask: True where a row is a point `[n]`; None means all.
        shape: Cells `(axial, angular)`. Static.
        half_length: Half the length of axis that the grid covers.

    Raises:
        ValueError: If a side of `shape` is below 1.
    """
    height, width = shape
    if height < 1 or width < 1:
        raise ValueError(f"shape: expected sides of at least 1, got {shape}")
    mask = jnp.ones(axial.shape, dtype=bool) if mask is None else mask
    inside = mask & (jnp.abs(axial) <= half_length)
    row = jnp.clip((axial + half_length) / (2.0 * half_length) * height - 0.5, 0.0, height - 1.0)
    column = angle / (2.0 * jnp.pi) * width - 0.5
    row_low, column_low = jnp.floor(row), jnp.floor(column)
    row_share, column_share = row - row_low, column - column_low
    rows = jnp.stack([row_low, jnp.minimum(row_low + 1, height - 1)], axis=1).astype(jnp.int32)
    columns = jnp.mod(jnp.stack([column_low, column_low + 1], axis=1).astype(jnp.int32), width)
    cells = (rows[:, :, None] * width + columns[:, None, :]).reshape(-1, 4)
    row_shares = jnp.stack([1.0 - row_share, row_share], axis=1)
    column_shares = jnp.stack([1.0 - column_share, column_share], axis=1)
    shares = (row_shares[:, :, None] * column_shares[:, None, :]).reshape(-1, 4)
    return RasterTaps(cells, jnp.where(inside[:, None], shares, 0.0))


def cylinder_raster(
    features: Float[Array, "n c"], taps: RasterTaps, *, shape: tuple[int, int], floor: float = 1e-3
) -> tuple[Float[Array, "h w c"], Float[Array, "h w"]]:
    """Mean of the point features in each cell, by bilinear shares: points to grid.

    Written as a product with the shares' matrix `[cells, n]`, so the backward pass is a product too, not a scatter.

    Args:
        features: Point features `[n, c]`.
        taps: From `raster_taps` with the same `shape`.
        shape: Cells `(axial, angular)`. Static.
        floor: Cells with less total share than this are empty.

    Returns:
        `(grid [h, w, c], occupancy [h, w])`: zero in empty cells; the occupancy is the summed share.
    """
    dense = _share_matrix(taps, shape[0] * shape[1])
    occupancy = jnp.sum(dense, axis=0)
    filled = occupancy > floor
    inverse = jnp.where(filled, 1.0 / jnp.where(filled, occupancy, 1.0), 0.0)
    grid = (dense * inverse[None, :]).T @ features
    return grid.reshape(*shape, features.shape[1]), occupancy.reshape(shape)


def sample_raster(grid: Float[Array, "h w c"], taps: RasterTaps) -> Float[Array, "n c"]:
    """Bilinear samples of a grid at the points: grid to points; zero on padding and outside the grid."""
    height, width, channels = grid.shape
    return _share_matrix(taps, height * width) @ grid.reshape(-1, channels)


def _share_matrix(taps: RasterTaps, cells: int) -> Float[Array, "n cells"]:
    """The bilinear shares as a dense matrix `[n, cells]`."""
    n = taps.cells.shape[0]
    flat = taps.cells + cells * jnp.arange(n)[:, None]
    dense = jnp.zeros(n * cells, taps.shares.dtype).at[flat.reshape(-1)].add(taps.shares.reshape(-1))
    return dense.reshape(n, cells)
