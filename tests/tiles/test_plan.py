"""How a cloud is cut into tiles."""

import numpy as np

from cablejax.tiles.plan import CELLS, add, cut, dealt, empty_grid


def test_a_long_cable_is_cut_finely_along_it():
    """Cells that were a share of the length held more points of 50 m of cable than a tile."""
    rng = np.random.default_rng(0)
    xyz = rng.uniform([0, 0, 0], [50_000, 60, 60], (200_000, 3))
    grid = empty_grid(xyz.min(axis=0), xyz.max(axis=0))
    add(grid, xyz)
    assert grid.held.sum() == len(xyz)
    assert grid.held.size <= CELLS
    tiles = cut(grid, halo=7.0, capacity=2_000)
    assert all(tile.outer(xyz).sum() <= 2_000 for tile in tiles)
    assert sum(tile.inner(xyz).sum() for tile in tiles) == len(xyz)


def test_tiles_are_full_though_strays_lie_far_from_the_cable():
    """Cut in halves, along the longest side of a box that strays had widened, this took three times as many tiles."""
    rng = np.random.default_rng(0)
    strays = rng.uniform([0, -150, -150], [800, 150, 150], (2_000, 3))
    xyz = np.concatenate([rng.uniform([0, -15, -15], [800, 15, 15], (100_000, 3)), strays])
    grid = empty_grid(xyz.min(axis=0), xyz.max(axis=0))
    add(grid, xyz)
    halo, capacity = 4.0, 15_000
    tiles = cut(grid, halo=halo, capacity=capacity)
    assert sum(tile.inner(xyz).sum() for tile in tiles) == len(xyz)
    assert all(tile.outer(xyz).sum() <= capacity for tile in tiles)
    least = len(xyz) / (capacity - 2 * halo * len(xyz) / 800)  # slices across, each with its halo
    assert len(tiles) <= 1.5 * least


def test_points_are_dealt_as_if_each_tile_had_looked_at_all():
    rng = np.random.default_rng(1)
    xyz = rng.normal([0, 0, 0], [400, 40, 40], (20_000, 3))
    grid = empty_grid(xyz.min(axis=0), xyz.max(axis=0))
    add(grid, xyz)
    tiles = cut(grid, halo=9.0, capacity=2_500)
    found = {number: (near, own) for number, near, own in dealt(tiles, xyz)}
    assert sorted(found) == [i for i, tile in enumerate(tiles) if tile.outer(xyz).any()]
    for number, (near, own) in found.items():
        np.testing.assert_array_equal(near, np.nonzero(tiles[number].outer(xyz))[0])
        np.testing.assert_array_equal(own, tiles[number].inner(xyz[near]))
    assert not list(dealt(tiles, xyz[:0]))
