"""How a cloud is cut into tiles: boxes that hold no more points, halo included, than one tile may."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

CELLS = 1 << 23  # at most, in all: a long cable has many along it and few across
FINER = 0.8


class Tile(NamedTuple):
    """A box of the cloud and the wider one whose points its own depend on; lower <= x < upper.

    Attributes:
        lower: `[3]`, mm; -inf at the border of the cloud.
        upper: `[3]`, mm; inf there.
        halo: How much wider the outer box is on every side, mm.
    """

    lower: Float[np.ndarray, "3"]
    upper: Float[np.ndarray, "3"]
    halo: float

    def inner(self, xyz: Float[np.ndarray, "n 3"]) -> np.ndarray:
        """Which points are the tile's own `[n]`."""
        return _within(xyz.T, self.lower, self.upper)

    def outer(self, xyz: Float[np.ndarray, "n 3"]) -> np.ndarray:
        """Which points lie in it or its halo `[n]`."""
        return _within(xyz.T, self.lower - self.halo, self.upper + self.halo)

    def slack(self, xyz: Float[np.ndarray, "n 3"]) -> np.ndarray:
        """Distance of points to the nearest side of the outer box beyond which the cloud goes on `[n]`."""
        return np.minimum(xyz - (self.lower - self.halo), (self.upper + self.halo) - xyz).min(axis=1)


class Grid(NamedTuple):
    """Cubic cells over a cloud and how many points each holds.

    Attributes:
        origin: `[3]`, mm.
        edge: mm.
        held: `[a, b, c]`.
    """

    origin: Float[np.ndarray, "3"]
    edge: float
    held: Int[np.ndarray, "a b c"]


def empty_grid(lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Grid:
    """A grid over a box, with the smallest cells that their number allows."""
    side = upper - lower
    edge = max(float(side.max()), 1e-9)
    while edge > 1e-9 and np.prod(np.floor(side / (FINER * edge)) + 1) <= CELLS:
        edge *= FINER
    return Grid(lower, edge, np.zeros(np.floor(side / edge).astype(int) + 1, dtype=np.int64))


def add(grid: Grid, xyz: Float[np.ndarray, "n 3"]) -> None:
    """Count more points."""
    cell = np.floor((xyz - grid.origin) / grid.edge).astype(int)
    cell = np.clip(cell, 0, np.array(grid.held.shape) - 1)
    flat = np.ravel_multi_index(tuple(cell.T), grid.held.shape)
    grid.held.reshape(-1)[:] += np.bincount(flat, minlength=grid.held.size)


def cut(grid: Grid, *, halo: float, capacity: int) -> list[Tile]:
    """Part the cloud, where the fewest points lie about the cut, until every piece with its halo fits, and fills a tile.

    Raises:
        ValueError: If a single cell with its halo holds more than `capacity` points.
    """
    shape, reach = np.array(grid.held.shape), int(np.ceil(halo / grid.edge))
    todo, done = [(np.zeros(3, dtype=int), shape.copy())], []
    while todo:
        low, high = todo.pop()
        if grid.held[_slices(low, high)].sum() == 0:
            continue
        # One cell more: a point on a cell's border may be rounded into either.
        held = int(grid.held[_slices(np.maximum(low - reach - 1, 0), high + reach + 1)].sum())
        if held <= capacity:
            done.append(_tile(grid, low, high, halo))
        elif (high - low).max() == 1:
            raise ValueError(
                f"tile_points: expected at least {held:,}, the points of {grid.edge:.3g} mm and {halo:.3g} mm around, "
                f"got {capacity:,}"
            )
        else:
            todo.extend(_parted(grid, low, high, reach + 1, capacity))
    return done


def dealt(tiles: Sequence[Tile], xyz: Float[np.ndarray, "n 3"]) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """For each tile that holds any: its number, which points lie in it or its halo, and whether in the tile itself.

    Neighbours in the list lie side by side (`cut`), so halves of it are dealt with by their common box: the work grows with
    the logarithm of the number of tiles.
    """
    todo = [(0, len(tiles), np.arange(len(xyz)), np.ascontiguousarray(xyz.T))]
    while todo:
        first, end, near, columns = todo.pop()
        some = tiles[first:end]
        lower, upper = np.min([tile.lower for tile in some], axis=0), np.max([tile.upper for tile in some], axis=0)
        inside = np.flatnonzero(_within(columns, lower - some[0].halo, upper + some[0].halo))
        near, columns = near[inside], np.stack([column[inside] for column in columns])
        if len(near) == 0:
            continue
        if len(some) == 1:
            yield first, near, _within(columns, lower, upper)
        else:
            middle = (first + end) // 2
            todo += [(middle, end, near, columns), (first, middle, near, columns)]


def _within(columns: Float[np.ndarray, "3 n"], lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Axis by axis: `all` over the three of a row takes several times as long."""
    inside = np.ones(columns.shape[1], dtype=bool)
    for column, low, high in zip(columns, lower, upper, strict=True):
        if low > -np.inf:
            inside &= column >= low
        if high < np.inf:
            inside &= column < high
    return inside


def _slices(low: np.ndarray, high: np.ndarray) -> tuple[slice, ...]:
    return tuple(slice(a, b) for a, b in zip(low, high, strict=True))


def _parted(
    grid: Grid, low: np.ndarray, high: np.ndarray, reach: int, capacity: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """A piece in two, such that both hold a whole number of full tiles as nearly as can be.

    Of the three axes the one is cut along which the fewest points lie within `reach` cells of the cut: they are worked on twice.
    """
    held, cuts = grid.held[_slices(low, high)], []
    for axis in np.flatnonzero(high - low > 1):
        along = np.concatenate([[0], np.cumsum(held.sum(axis=tuple(a for a in range(3) if a != axis)))])
        half = _place(along, 0.5)
        parts = max(2, math.ceil(along[-1] / max(1, capacity - _about(along, half, reach))))
        place = _place(along, (parts // 2) / parts)
        cuts.append((_about(along, place, reach), -len(along), int(axis), low[axis] + place))
    *_, axis, place = min(cuts)
    middle_high, middle_low = high.copy(), low.copy()
    middle_high[axis] = middle_low[axis] = place
    return [(low, middle_high), (middle_low, high)]


def _place(along: np.ndarray, share: float) -> int:
    """The border between cells below which that share of the points lies, as nearly as can be; none of the ends."""
    return int(np.clip(np.searchsorted(along, share * along[-1]), 1, len(along) - 2))


def _about(along: np.ndarray, place: int, reach: int) -> int:
    """Points within some cells of a border."""
    return int(along[min(place + reach, len(along) - 1)] - along[max(place - reach, 0)])


def _tile(grid: Grid, low: np.ndarray, high: np.ndarray, halo: float) -> Tile:
    at = [np.where(low == 0, -np.inf, grid.origin + low * grid.edge)]
    at.append(np.where(high == grid.held.shape, np.inf, grid.origin + high * grid.edge))
    return Tile(at[0], at[1], halo)
