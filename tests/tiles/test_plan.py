"""How a cloud is cut into tiles."""

import numpy as np

from cablejax.tiles.plan import add, cut, empty_grid


def test_a_long_cable_is_cut_finely_along_it():
    """Cells that were a share of the length held more points of 50 m of cable than a tile."""
    rng = np.random.default_rng(0)
    xyz = rng.uniform([0, 0, 0], [50_000, 60, 60], (200_000, 3))
    grid = empty_grid(xyz.min(axis=0), xyz.max(axis=0))
    add(grid, xyz)
    assert grid.held.sum() == len(xyz)
    assert grid.held.size <= 1 << 21
    tiles = cut(grid, halo=7.0, capacity=2_000)
    assert all(tile.outer(xyz).sum() <= 2_000 for tile in tiles)
    assert sum(tile.inner(xyz).sum() for tile in tiles) == len(xyz)
