"""What is done with one tile, as tasks that any process may run that sees the folder.

Each reads the tile's points, leaves its arrays in a file of its own (`Folder.leave`) and returns what is short. Files that
several machines write at once would be torn, so the columns of the cloud are written by the one process that leads.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from cablejax.tiles import kernels
from cablejax.tiles.folder import Folder, TilePoints
from cablejax.tiles.plan import Tile
from cablejax.tiles.region import fetched

QUERIES = 1024  # strays searched at once
PILOTS = 256  # pilot points of a tile at once
STRAYS = "strays.npy"
PILOT_ROWS = "pilots.npy"


def warm(*, capacity: int, removal_k: int, smooth: bool, **options: int) -> None:
    """Load, or compile, the programs of all work here: a process can while another still reads the file."""
    cloud, one = kernels.padded(np.zeros((1, 3), np.float32), capacity), jnp.float32(1.0)
    kernels.scores.load(cloud, removal_k=removal_k)
    kernels.nearest.load(cloud, jnp.zeros((QUERIES, 3)), removal_k=removal_k)
    if smooth and options["order"]:
        pilots = jnp.full(PILOTS, -1, jnp.int32)
        kernels.width_trial.load(cloud, cloud.mask, pilots, k=options["k"], order=options["order"])
    if smooth:
        kernels.smooth.load(cloud, cloud.mask, one, one, **options)


def score(
    *, folder: str, tile: int, box: list[Any], capacity: int, removal_k: int, region: dict[str, Any] | None
) -> dict[str, Any]:
    """Scores of the tile's own points.

    Args:
        folder, tile, box, capacity, removal_k: As for all work here.
        region: Where the points have still to be fetched, as `region.fetched` takes it.

    Returns:
        How many points are the tile's own, and the rows of those whose neighbours it does not all hold (`strays`).
    """
    place = Folder.existing(folder)
    if region is not None:
        place.keep_tile(tile, fetched(_tile(box), **region))
    points = place.tile(tile)
    values, reach = kernels.scores(kernels.padded(points.xyz, capacity), removal_k=removal_k)
    mine = np.nonzero(points.inner)[0]
    place.leave(f"scoring {tile}", row=points.row[mine], score=np.asarray(values)[mine])
    cut_off = np.asarray(reach)[mine] >= _tile(box).slack(points.xyz[mine].astype(np.float64))
    return {"own": len(mine), "strays": points.row[mine][cut_off].tolist()}


def strays(*, folder: str, tile: int, capacity: int, removal_k: int) -> None:
    """Squared distances of all strays to their nearest among the tile's own points."""
    place = Folder.existing(folder)
    points, queries = place.tile(tile), np.load(place.path / STRAYS)
    cloud = kernels.padded(points.xyz[points.inner], capacity)
    parts = [jnp.asarray(queries[start : start + QUERIES]) for start in range(0, len(queries), QUERIES)]
    found = [np.asarray(kernels.nearest(cloud, part, removal_k=removal_k)) for part in parts]
    place.leave(f"strays {tile}", sq_dist=np.concatenate(found))


def width(*, folder: str, tile: int, capacity: int, n: int, k: int, order: int) -> None:
    """Trials of the filter's width at those pilot points of the cloud that are the tile's own."""
    place = Folder.existing(folder)
    points = place.tile(tile)
    rows = np.nonzero(points.inner & np.isin(points.row, np.load(place.path / PILOT_ROWS)))[0]
    cloud, keep = kernels.padded(points.xyz, capacity), _kept(place, points, n, capacity)
    parts = []
    for start in range(0, len(rows), PILOTS):
        some = np.full(PILOTS, -1, dtype=np.int32)
        part = rows[start : start + PILOTS]
        some[: len(part)] = part
        parts.append(kernels.width_trial(cloud, keep, jnp.asarray(some), k=k, order=order))
    fields = zip(*parts, strict=True)
    names = parts[0]._fields if parts else ()
    place.leave(f"width {tile}", **{name: np.concatenate(f, -1) for name, f in zip(names, fields, strict=True)})


def smooth(
    *, folder: str, tile: int, box: list[Any], capacity: int, n: int, alpha: float, usual: float, **options: int
) -> list[float]:
    """The tile's own kept points, filtered; returns squared moves, widths, points cut off and points, each summed."""
    place = Folder.existing(folder)
    points = place.tile(tile)
    keep = _kept(place, points, n, capacity)
    cloud = kernels.padded(points.xyz, capacity)
    result = kernels.smooth(cloud, keep, jnp.float32(alpha), jnp.float32(usual), **options)
    mine = np.nonzero(points.inner & np.asarray(keep)[: len(points.row)])[0]
    xyz = np.asarray(result.xyz)[mine]
    place.leave(f"smoothing {tile}", row=points.row[mine], xyz=xyz)
    cut_off = np.asarray(result.need)[mine] >= _tile(box).slack(points.xyz[mine].astype(np.float64))
    moved = ((xyz.astype(np.float64) - points.xyz[mine]) ** 2).sum()
    wide = np.asarray(result.width)[mine].sum(dtype=np.float64)
    return [float(moved), float(wide), float(cut_off.sum()), float(len(mine))]


def _tile(box: list[Any]) -> Tile:
    low, high, halo = box
    return Tile(np.array(low), np.array(high), halo)


def _kept(place: Folder, points: TilePoints, n: int, capacity: int) -> Any:
    keep = np.zeros(capacity, dtype=bool)
    keep[: len(points.row)] = np.memmap(place.path / "keep", dtype=bool, mode="r", shape=(n,))[points.row]
    return jnp.asarray(keep)
