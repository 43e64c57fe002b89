"""Outlier removal and the adaptive filter for files larger than memory, tile by tile, and on from where it was killed."""

import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from cablejax.batch import Engine, Here, Task
from cablejax.io import PointWriter, iter_points
from cablejax.ops import Trial, choose_alpha, pilot_places, usual_noise
from cablejax.tiles.folder import Folder, TilePoints
from cablejax.tiles.plan import Tile, add, cut, dealt, empty_grid
from cablejax.tiles.region import region_of
from cablejax.tiles.survey import blocks, survey, typical_reach
from cablejax.tiles.work import PILOT_ROWS, QUERIES, STRAYS

Progress = Callable[[str, int, int], None]
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
    engine: Engine | None = None,
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
        engine: Where the tiles are worked on; in this process if None. Processes of `cablejax.batch` and workers of a
            cluster have one thread each and give the same numbers bit for bit; this process may differ in the last.
        progress: Told the stage, how many tiles of it are done, and of how many.

    Raises:
        ValueError: If `tile_points` is too few for one place and its halo, or the cloud has no more than k points.
        PointFileError: If the source cannot be read or the target written.
        TileError: If a tile's work failed, or took its process with it each time.
    """
    settings = settings or Settings()
    source, target = Path(source), Path(target)
    about = source.stat() if source.exists() else None
    job = {
        "source": str(source.resolve()), "size": about and about.st_size, "changed": about and about.st_mtime_ns,
        "unit": unit, "columns": columns, "tile_points": tile_points, "chunk": chunk, "layout": 2, **asdict(settings),
    }  # fmt: skip
    place = Path(folder) if folder is not None else target.with_name(target.name + ".tiles")
    run = _Run(Folder.of_job(place, job), settings, tile_points, engine or Here(), progress or (lambda *_: None))
    run.prepare(source, unit, columns, chunk)
    run.remove_outliers()
    if settings.smooth:
        run.smooth()
    result = run.write(source, target, unit, columns, chunk)
    run.folder.remove()
    return result


class TileError(Exception):
    """The work on a tile failed; the message says which and why."""


class _Run:
    """A run and what its finished stages found."""

    def __init__(self, folder: Folder, settings: Settings, capacity: int, engine: Engine, progress: Progress):
        self.folder, self.settings, self.capacity, self.engine = folder, settings, capacity, engine
        self.progress = progress

    def prepare(self, source: Path, unit: str, columns: str | None, chunk: int) -> None:
        """Read the file, cut it into tiles, and where each does not fetch its points itself write them into its file."""
        self.about = self.folder.done("survey")
        if self.folder.done("plan") is None:
            self.engine.warm(Task("programs", "cablejax.tiles.work:warm", self._programs(), os.getcwd()))
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
        self.region = region_of(source, unit, self.about)
        plan = self.folder.done("plan")
        if plan is None:
            self.progress("cutting", 0, 1)
            plan = self.folder.finish("plan", self._cut())
        self.halo, self.boxes = plan["halo"], [[low, high, plan["halo"]] for low, high in plan["boxes"]]

    def _programs(self) -> dict[str, Any]:
        settings = self.settings
        own = {"k": settings.k, "order": settings.order, "refinements": settings.refinements}
        return {"capacity": self.capacity, "removal_k": settings.removal_k, "smooth": settings.smooth, **own}

    def _cut(self) -> dict[str, Any]:
        settings = self.settings
        hops = 1 + (settings.refinements if settings.order else 0)
        halo = HALO * hops * typical_reach(self.points, settings.k if settings.smooth else settings.removal_k)
        grid = empty_grid(np.array(self.about["lower"]), np.array(self.about["upper"]))
        for _, xyz in blocks(self.points, 1_000_000):
            add(grid, xyz.astype(np.float64))
        tiles = cut(grid, halo=halo, capacity=self.capacity)
        self.folder.clear_spool()
        if self.region is None:
            self._spool(tiles)
        return {"halo": halo, "boxes": [[t.lower.tolist(), t.upper.tolist()] for t in tiles]}

    def _spool(self, tiles: list[Tile]) -> None:
        """Write each tile's points into a file of its own, in one pass over all."""
        for row, xyz in blocks(self.points, 1_000_000):
            for i, near, own in dealt(tiles, xyz.astype(np.float64)):
                self.folder.spool(i, TilePoints(row[near], xyz[near], own))

    def _each(self, stage: str, function: str, *, box: bool = False, **arguments: Any) -> Iterator[tuple[int, Any]]:
        """Work on the tiles that a stage has still to do: number and what was returned, in any order.

        Raises:
            TileError: If one fails.
        """
        todo = [i for i in range(len(self.boxes)) if self.folder.done(f"{stage} {i}") is None]
        done = len(self.boxes) - len(todo)
        self.progress(stage, done, len(self.boxes))
        arguments |= {"folder": str(self.folder.path.resolve()), "capacity": self.capacity}
        tasks = []
        for i in todo:
            own = {"tile": i, "box": self.boxes[i]} if box else {"tile": i}
            tasks.append(Task(str(i), f"cablejax.tiles.work:{function}", own | arguments, os.getcwd()))
        outcomes = self.engine.run(tasks)
        try:
            for outcome in outcomes:
                if outcome.kind != "returned":
                    raise TileError(f"{stage}: tile {outcome.name} of {len(self.boxes)}: {outcome.reason}")
                yield int(outcome.name), outcome.value
                done += 1
                self.progress(stage, done, len(self.boxes))
        finally:
            outcomes.close()

    def remove_outliers(self) -> None:
        """Score all points, then compare the scores with the threshold of the whole cloud."""
        self.keep = self.folder.column("keep", bool, (self.n,))
        if self.folder.done("removal") is not None:
            return
        score = self.folder.column("score", np.float32, (self.n,))
        given = {"removal_k": self.settings.removal_k, "region": self.region}
        for i, told in self._each("scoring", "score", box=True, **given):
            found = self.folder.take(f"scoring {i}")
            score[found["row"]] = found["score"]
            score.flush()
            self.folder.finish(f"scoring {i}", told)
        held = sum(self.folder.done(f"scoring {i}")["own"] for i in range(len(self.boxes)))
        if self.region is not None and held != self.n:
            raise TileError(
                f"{self.region['source']}: its octree does not hold all points where it says: {held:,} of {self.n:,}"
            )
        self._score_strays(score)
        self._threshold(score)

    def _score_strays(self, score: np.memmap) -> None:
        """Search the neighbours of points whose own tile does not hold them all in every tile."""
        found = [np.array(self.folder.done(f"scoring {i}")["strays"], dtype=int) for i in range(len(self.boxes))]
        rows = np.concatenate(found)
        if len(rows) == 0:
            return
        k, total = self.settings.removal_k, -(-len(rows) // QUERIES) * QUERIES
        queries = np.zeros((total, 3), dtype=np.float32)
        queries[: len(rows)] = self.points[rows]
        np.save(self.folder.path / STRAYS, queries)
        best = np.full((total, k), np.inf, dtype=np.float32)
        for i, _ in self._each("strays", "strays", removal_k=k):
            both = np.concatenate([best, self.folder.take(f"strays {i}")["sq_dist"]], axis=1)
            best = np.sort(both, axis=1)[:, :k]
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
        for i, sums in self._each("smoothing", "smooth", box=True, n=self.n, alpha=alpha, usual=usual, **options):
            found = self.folder.take(f"smoothing {i}")
            moved[found["row"]] = found["xyz"]
            moved.flush()
            self.folder.finish(f"smoothing {i}", sums)

    def _width(self) -> tuple[float, float]:
        """The width of eq. (5) per local noise, and the usual noise off the surface, of the whole cloud."""
        known, usual = self.folder.done("alpha"), self.folder.done("usual noise")
        if self.settings.order == 0:
            return 1.0, 0.0
        if known is not None and usual is not None:
            return known, usual
        np.save(self.folder.path / PILOT_ROWS, self._pilot_rows())
        options = {"n": self.n, "k": self.settings.k, "order": self.settings.order}
        parts = {i: self.folder.take(f"width {i}") for i, _ in self._each("width", "width", **options)}
        held = [parts[i] for i in sorted(parts) if parts[i]]  # in one order, whichever came first
        whole = Trial(*(jnp.concatenate([part[name] for part in held], axis=-1) for name in Trial._fields))
        alpha = choose_alpha(whole)
        usual = self.folder.finish("usual noise", float(usual_noise(whole, alpha)))
        return self.folder.finish("alpha", float(alpha)), usual

    def _pilot_rows(self) -> np.ndarray:
        """Rows of the kept points at which the whole cloud chooses its width."""
        places = np.asarray(pilot_places(int(np.count_nonzero(self.keep))))
        found, before = [], 0
        for start in range(0, self.n, 1_000_000):
            kept = start + np.nonzero(self.keep[start : start + 1_000_000])[0]
            found.append(kept[places[(places >= before) & (places < before + len(kept))] - before])
            before += len(kept)
        return np.concatenate(found)

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
        for i in range(len(self.boxes) if smooth else 0):
            sums += self.folder.done(f"smoothing {i}")
        count = max(1.0, sums[3])
        alpha = (self.folder.done("alpha") or 1.0) if smooth else None
        return TiledResult(
            points=removal["points"],
            dropped=self.about["dropped"],
            removed=removal["removed"],
            tiles=len(self.boxes),
            halo_mm=self.halo,
            alpha=alpha,
            moved_rms_mm=float(np.sqrt(sums[0] / count)),
            width_mm=float(sums[1] / count),
            cut=int(sums[2]),
        )
