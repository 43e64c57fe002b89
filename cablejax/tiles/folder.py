"""The folder that a tiled run works in: what it knows so far, so that it can go on after it was killed."""

import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from cablejax.io import atomic_write

STATE = "state.json"
RECORD = np.dtype([("row", "<i8"), ("xyz", "<f4", 3), ("inner", "?")])


class TilePoints(NamedTuple):
    """The points of a tile and its halo.

    Attributes:
        row: Their rows in the whole cloud `[m]`.
        xyz: Coordinates `[m, 3]` float32, mm, shifted.
        inner: True for the tile's own `[m]`.
    """

    row: Int[np.ndarray, " m"]
    xyz: Float[np.ndarray, "m 3"]
    inner: Bool[np.ndarray, " m"]


class Folder:
    """Files of a tiled run and its state; `job` says what the run is, and a folder of another job is emptied.

    Columns of the cloud (points, scores, what is kept, results) are files of one row a point, read and written through
    the system's page cache; nothing but the tile at work is held in memory.
    """

    def __init__(self, path: Path, state: dict[str, Any]):
        self.path, self.state = path, state

    @classmethod
    def of_job(cls, path: Path, job: dict[str, Any]) -> "Folder":
        """The folder of a job, with what it knows."""
        state = _state(path)
        if state.get("job") != job:
            shutil.rmtree(path, ignore_errors=True)
            path.mkdir(parents=True)
            state = {"job": job, "done": {}}
        return cls(path, state)

    @classmethod
    def existing(cls, path: str | Path) -> "Folder":
        """A folder that another process leads, for the work on one of its tiles."""
        return cls(Path(path), {})

    def done(self, stage: str) -> Any:
        """What a finished stage left, None if it is not finished."""
        return self.state["done"].get(stage)

    def finish(self, stage: str, value: Any = True) -> Any:
        """Keep what a stage found; the state is replaced in one step."""
        self.state["done"][stage] = value
        fresh = self.path / (STATE + ".new")
        fresh.write_text(json.dumps(self.state))
        fresh.replace(self.path / STATE)
        return value

    def column(self, name: str, dtype: Any, shape: tuple[int, ...]) -> np.memmap:
        """A file of one row a point, made full of zeros where it is missing."""
        path = self.path / name
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        if not path.exists() or path.stat().st_size != size:
            with path.open("wb") as file:
                file.truncate(size)
        return np.memmap(path, dtype=dtype, mode="r+", shape=shape)

    def spool(self, tile: int, points: TilePoints) -> None:
        """Add points to a tile's file."""
        with (self.path / f"tile{tile}").open("ab") as file:
            file.write(_recorded(points).tobytes())

    def keep_tile(self, tile: int, points: TilePoints) -> None:
        """Write all points of a tile, in one step."""
        with atomic_write(self.path / f"tile{tile}") as file:
            file.write(_recorded(points).tobytes())

    def tile(self, tile: int) -> TilePoints:
        """The points of a tile."""
        record = np.fromfile(self.path / f"tile{tile}", dtype=RECORD)
        return TilePoints(record["row"], np.ascontiguousarray(record["xyz"]), record["inner"])

    def leave(self, name: str, **arrays: np.ndarray) -> None:
        """Keep a tile's arrays until they are taken, in one step."""
        with atomic_write(self.path / f"{name}.npz") as file:
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType] its stub takes arrays for its own options

    def take(self, name: str) -> dict[str, np.ndarray]:
        """A tile's arrays; the file goes."""
        path = self.path / f"{name}.npz"
        with np.load(path) as file:
            arrays = dict(file)
        path.unlink()
        return arrays

    def clear_spool(self) -> None:
        """Delete the tiles of a spooling that was not finished."""
        for path in self.path.glob("tile*"):
            path.unlink()

    def remove(self) -> None:
        """Delete the folder."""
        shutil.rmtree(self.path)


def _recorded(points: TilePoints) -> np.ndarray:
    record = np.empty(len(points.row), dtype=RECORD)
    record["row"], record["xyz"], record["inner"] = points
    return record


def _state(path: Path) -> dict[str, Any]:
    try:
        return json.loads((path / STATE).read_text())
    except (OSError, ValueError):
        return {}
