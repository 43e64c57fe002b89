"""Outlier removal and the adaptive filter for files larger than memory, tile by tile, and on from where it was killed."""

import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from cablejax.io import PointWriter, iter_points
from cablejax.ops import Trial, choose_alpha, pilot_step, usual_noise, width_trial
from cablejax.tiles import kernels
from cablejax.tiles.folder import Folder, TilePoints
from cablejax.tiles.plan import Tile, add, cut, empty_grid
from cablejax.tiles.survey import blocks, survey, typical_reach

Progress = Callable[[str, int, int], None]
QUERIES = 1024  # strays searched at once
PILOTS = 256  # pilot points of a tile at once
HALO = 1.5  # halo per reach of a typical neighbourhood


@dataclass(frozen=True)
class Settings:
    """What `clean` is asked for; see there."""

    removal_k: int = 20
    std_ratio: float = 2.0
    k: int = 100
    order: int = 2
    refinements: int = 1
    smooth: bool = True


class TiledResult(NamedTuple):
    """What a tiled run did.

    Attributes:
        points: Valid points read.
        dropped: Invalid returns left out.
        removed: Outliers among the points.
        tiles: How many tiles there were.
        halo_mm: Width of their halo.
        alpha: Kernel width per local noise; None where nothing was smoothed.
        moved_rms_mm: Root mean square of how far points were moved.
        width_mm: Mean kernel width.
        cut: Kept points whose result depends on points beyond their tile's halo: not those of the whole cloud.
    """

    points: int
    dropped: int
    removed: int
    tiles: int
    halo_mm: float
    alpha: float | None
    moved_rms_mm: float
    width_mm: float
    cut: int


def denoise_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    settings: Settings | None = None,
    unit: str = "mm",
    columns: str | None = None,
    tile_points: int = 1 << 18,
    chunk: int = 1_000_000,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> TiledResult:
    """Clean a point file of any size: `clean` on the whole cloud, to rounding, in the memory of one tile.

    Points keep their order, colours and intensities. A killed run goes on from its last finished tile when it is called
    again with the same arguments and the same source. The disk must hold 60 bytes a point meanwhile.

    Args:
        source: A file that `iter_points` reads.
        target: A file that `PointWriter` writes.
        settings: Of removal and filter; the defaults if None.
        unit: Of the source and the target.
        columns: What the columns of a text table are, as for `read_points`.
        tile_points: Most points of a tile with its halo: what memory goes by.
        chunk: Points read and written at once.
        folder: Where to work; beside the target if None. Deleted at the end.
        progress: Told the stage, how many tiles of it are done, and of how many.

    Raises:
        ValueError: If `tile_points` is too few for one place and its halo, or the cloud has no more than k points.
        PointFileError: If the source cannot be read or the target written.
    """
    settings = settings or Settings()
    source, target = Path(source), Path(target)
    about = source.stat() if source.exists() else None
    job = {
        "source": str(source.resolve()), "size": about and about.st_size, "changed": about and about.st_mtime_ns,
        "unit": unit, "columns": columns, "tile_points": tile_points, "chunk": chunk, **asdict(settings),
    }  # fmt: skip
    place = Path(folder) if folder is not None else target.with_name(target.name + ".tiles")
    run = _Run(Folder(place, job), settings, tile_points, progress or (lambda *_: None))
    run.prepare(source, unit, columns, chunk)
    run.remove_outliers()
    if settings.smooth:
        run.smooth()
    result = run.write(source, target, unit, columns, chunk)
    run.folder.remove()
    return result


class _Run:
    """A run and what its finished stages found."""

    def __init__(self, folder: Folder, settings: Settings, capacity: int, progress: Progress):
        self.folder, self.settings, self.capacity, self.progress = folder, settings, capacity, progress

    def prepare(self, source: Path, unit: str, columns: str | None, chunk: int) -> None:
        """Read the file, cut it into tiles, and write each tile's points into a file of its own."""
        self.about = self.folder.done("survey")
        if self.about is None:
            self.progress("reading", 0, 1)
            self.about = self.folder.finish(
                "survey", survey(self.folder, source, unit=unit, columns=columns, chunk=chunk)
            )
        self.n = self.about["n"]
        least = max(self.settings.k, self.settings.removal_k)
        if self.n <= least:
            raise ValueError(f"points: expected more than {least}, got {self.n}")
        self.points = self.folder.column("points", np.float32, (self.n, 3))
        plan = self.folder.done("plan")
        if plan is None:
            self.progress("cutting", 0, 1)
            plan = self.folder.finish("plan", self._cut())
        self.tiles = [Tile(np.array(low), np.array(high), plan["halo"]) for low, high in plan["boxes"]]

    def _cut(self) -> dict[str, Any]:
        settings = self.settings
        hops = 1 + (settings.refinements if settings.order else 0)
        halo = HALO * hops * typical_reach(self.points, settings.k if settings.smooth else settings.removal_k)
        grid = empty_grid(np.array(self.about["lower"]), np.array(self.about["upper"]))
        for _, xyz in blocks(self.points, 1_000_000):
            add(grid, xyz.astype(np.float64))
        tiles = cut(grid, halo=halo, capacity=self.capacity)
        self.folder.clear_spool()
        for row, xyz in blocks(self.points, 1_000_000):
            wide = xyz.astype(np.float64)
            for i, tile in enumerate(tiles):
                near = np.nonzero(tile.outer(wide))[0]
                if len(near):
                    self.folder.spool(i, row[near], xyz[near], tile.inner(wide[near]))
        return {"halo": halo, "boxes": [[t.lower.tolist(), t.upper.tolist()] for t in tiles]}

    def _unfinished(self, stage: str) -> Iterator[tuple[int, Tile, TilePoints]]:
        """Tiles that a stage has still to do."""
        for i, tile in enumerate(self.tiles):
            self.progress(stage, i, len(self.tiles))
            if self.folder.done(f"{stage} {i}") is None:
                yield i, tile, self.folder.tile(i)
        self.progress(stage, len(self.tiles), len(self.tiles))

    def remove_outliers(self) -> None:
        """Score all points, then compare the scores with the threshold of the whole cloud."""
        self.keep = self.folder.column("keep", bool, (self.n,))
        if self.folder.done("removal") is not None:
            return
        score = self.folder.column("score", np.float32, (self.n,))
        for i, tile, points in self._unfinished("scoring"):
            values, reach = kernels.scores(kernels.padded(points.xyz, self.capacity), removal_k=self.settings.removal_k)
            mine = np.nonzero(points.inner)[0]
            score[points.row[mine]] = np.asarray(values)[mine]
            cut_off = np.asarray(reach)[mine] >= tile.slack(points.xyz[mine].astype(np.float64))
            score.flush()
            self.folder.finish(f"scoring {i}", points.row[mine][cut_off].tolist())
        self._score_strays(score)
        self._threshold(score)

    def _score_strays(self, score: np.memmap) -> None:
        """Search the neighbours of points whose own tile does not hold them all in every tile."""
        found = [np.array(self.folder.done(f"scoring {i}"), dtype=int) for i in range(len(self.tiles))]
        rows = np.concatenate(found)
        if len(rows) == 0:
            return
        k, total = self.settings.removal_k, -(-len(rows) // QUERIES) * QUERIES
        queries = np.zeros((total, 3), dtype=np.float32)
        queries[: len(rows)] = self.points[rows]
        best = np.full((total, k), np.inf, dtype=np.float32)
        for i in range(len(self.tiles)):
            self.progress("strays", i, len(self.tiles))
            points = self.folder.tile(i)
            cloud = kernels.padded(points.xyz[points.inner], self.capacity)
            for start in range(0, total, QUERIES):
                part = slice(start, start + QUERIES)
                found = np.asarray(kernels.nearest(cloud, jnp.asarray(queries[part]), removal_k=k))
                best[part] = np.sort(np.concatenate([best[part], found], axis=1), axis=1)[:, :k]
        # The nearest is the point itself, at distance zero, which the score counts.
        score[rows] = np.sqrt(best[: len(rows)]).sum(axis=1) / k

    def _threshold(self, score: np.memmap) -> None:
        valid = np.isfinite(self.points).all(axis=1)
        used = np.asarray(score, dtype=np.float64)[valid]
        threshold = used.mean() + self.settings.std_ratio * used.std(ddof=1)
        self.keep[:] = valid & (
            (score < threshold) | (score == 0)
        )  # as `statistical_outliers`: duplicates are no outliers
        self.keep.flush()
        self.folder.finish("removal", {"points": int(valid.sum()), "removed": int(valid.sum() - self.keep.sum())})

    def smooth(self) -> None:
        """Estimate the width from pilot points of all tiles, then filter tile by tile."""
        alpha, usual = self._width()
        moved = self.folder.column("moved", np.float32, (self.n, 3))
        options = {"k": self.settings.k, "order": self.settings.order, "refinements": self.settings.refinements}
        for i, tile, points in self._unfinished("smoothing"):
            cloud = kernels.padded(points.xyz, self.capacity)
            result = kernels.smooth(cloud, self._kept(points), jnp.float32(alpha), jnp.float32(usual), **options)
            mine = np.nonzero(points.inner & self.keep[points.row])[0]
            xyz = np.asarray(result.xyz)[mine]
            moved[points.row[mine]] = xyz
            moved.flush()
            cut_off = np.asarray(result.need)[mine] >= tile.slack(points.xyz[mine].astype(np.float64))
            step = ((xyz.astype(np.float64) - points.xyz[mine]) ** 2).sum()
            width = float(np.asarray(result.width)[mine].sum(dtype=np.float64))
            self.folder.finish(f"smoothing {i}", [float(step), width, int(cut_off.sum()), len(mine)])

    def _kept(self, points: TilePoints) -> Any:
        keep = np.zeros(self.capacity, dtype=bool)
        keep[: len(points.row)] = self.keep[points.row]
        return jnp.asarray(keep)

    def _width(self) -> tuple[float, float]:
        """The width of eq. (5) per local noise, and the usual noise off the surface, of the whole cloud."""
        known, usual = self.folder.done("alpha"), self.folder.done("usual noise")
        if self.settings.order == 0:
            return 1.0, 0.0
        if known is not None and usual is not None:
            return known, usual
        step, parts = pilot_step(self.n), []
        for _, _, points in self._unfinished("width"):
            rows = np.nonzero(points.inner & (points.row % step == 0))[0]
            cloud, keep = kernels.padded(points.xyz, self.capacity), self._kept(points)
            for start in range(0, len(rows), PILOTS):
                some = np.full(PILOTS, -1, dtype=np.int32)
                part = rows[start : start + PILOTS]
                some[: len(part)] = part
                trial = width_trial(cloud, keep, jnp.asarray(some), k=self.settings.k, order=self.settings.order)
                parts.append(trial)
        whole = Trial(*(jnp.concatenate(fields, axis=-1) for fields in zip(*parts, strict=True)))
        alpha = choose_alpha(whole)
        usual = self.folder.finish("usual noise", float(usual_noise(whole, alpha)))
        return self.folder.finish("alpha", float(alpha)), usual

    def write(self, source: Path, target: Path, unit: str, columns: str | None, chunk: int) -> TiledResult:
        """Read the source again and write what is left of it."""
        smooth = self.settings.smooth
        moved = self.folder.column("moved", np.float32, (self.n, 3)) if smooth else self.points
        shift, start = np.array(self.about["shift"]), 0
        with PointWriter(target, unit=unit) as writer:
            for piece in iter_points(source, unit=unit, columns=columns, chunk=chunk):
                part = slice(start, start + len(piece.xyz_mm))
                start, kept = part.stop, np.asarray(self.keep[part])
                self.progress("writing", start, self.n)
                if not kept.any():
                    continue
                xyz = np.asarray(moved[part][kept], dtype=np.float64) + shift if smooth else piece.xyz_mm[kept]
                color, intensity = (None if f is None else f[kept] for f in (piece.color, piece.intensity))
                writer.write(xyz, color=color, intensity=intensity)
        return self._result()

    def _result(self) -> TiledResult:
        removal, smooth = self.folder.done("removal"), self.settings.smooth
        sums = np.zeros(4)
        for i in range(len(self.tiles) if smooth else 0):
            sums += self.folder.done(f"smoothing {i}")
        count = max(1.0, sums[3])
        alpha = (self.folder.done("alpha") or 1.0) if smooth else None
        return TiledResult(
            removal["points"], self.about["dropped"], removal["removed"], len(self.tiles),
            self.tiles[0].halo, alpha, float(np.sqrt(sums[0] / count)), float(sums[1] / count), int(sums[2]),
        )  # fmt: skip
