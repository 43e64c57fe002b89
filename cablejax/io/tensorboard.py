"""A run's log for TensorBoard: scalars, hyper-parameters, confusion matrices and point clouds. Needs no display."""

import os
import secrets
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Array, Num
from numpy.typing import ArrayLike

from cablejax.optional import require


class RunLogger:
    """Write TensorBoard events into a folder; as a context manager it closes, errors or not.

    Events are written by the caller's thread. tensorboardX's own writer hands them to a queue, which blocks for good
    once its thread has died of a full disk, and a second writer in the same second overwrites the first one's file.

    No value ends a run: NaN and infinities are logged, and what has no place in a log (None, text, an array where a number
    belongs, a histogram of nothing) is left out with a warning. A full disk and a wrong number of labels are errors.

    Args:
        folder: Where the event files go; made if it is missing.
        purge_step: For a run that goes on at this step: TensorBoard forgets what an earlier, killed run logged from
            here on.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder, RunLogger(folder) as log:
        ...     log.scalars({"train/loss": 0.5, "train/accuracy": 0.9}, step=1)
    """

    def __init__(self, folder: str | os.PathLike[str], *, purge_step: int | None = None):
        self.folder = Path(folder)
        self._events = _open_events(self.folder)
        self._closed = False
        if purge_step is not None:
            from tensorboardX.proto.event_pb2 import SessionLog  # pyright: ignore[reportAttributeAccessIssue]

            self._write(purge_step, session_log=SessionLog(status=SessionLog.START))

    def scalar(self, name: str, value: object, step: int) -> None:
        """Log one number at a step."""
        self.scalars({name: value}, step)

    def scalars(self, values: Mapping[str, object], step: int) -> None:
        """Log several numbers at a step, each a curve of its own; arrays of one element are numbers too."""
        from tensorboardX import summary

        for name, number in _numbers(values).items():
            self._write(step, summary=summary.scalar(name, number))

    def hparams(self, settings: Mapping[str, object], metrics: Mapping[str, object], *, name: str = "hparams") -> None:
        """Log a run's settings with its final figures.

        Args:
            settings: Finite numbers, booleans and strings are kept as they are, None and the rest as text.
            metrics: Final figures, by name.
            name: Sub-folder of the entry, so that a run has one entry however often it is started.
        """
        from tensorboardX import summary

        figures = _numbers(metrics)
        with RunLogger(self.folder / name) as entry:
            for part in summary.hparams({key: _setting(value) for key, value in settings.items()}, figures):
                entry._write(0, summary=part)
            entry.scalars(figures, 0)

    def histogram(self, name: str, values: ArrayLike, step: int) -> None:
        """Log the distribution of an array's finite entries, such as attention weights."""
        from tensorboardX import summary

        every = np.asarray(values, np.float64).reshape(-1)
        finite = every[np.isfinite(every)]
        if not len(finite):
            _leave_out(name, f"none of its {len(every)} values is a finite number")
            return
        if len(finite) < len(every):
            _warn(
                f"{name}: {len(every) - len(finite)} of its {len(every)} values are left out, being no finite numbers"
            )
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                content = summary.histogram(name, finite, bins=64)
        except ValueError as error:  # a range too wide or too narrow for 64 bins
            _leave_out(name, str(error))
            return
        self._write(step, summary=content)

    def image(self, name: str, pixels: Num[Array | np.ndarray, "height width channels"], step: int) -> None:
        """Log an image `[height, width, 1 or 3]`, uint8 or float in 0..1; NaN is black."""
        from tensorboardX import summary

        values = np.asarray(pixels)
        if not values.size or values.ndim != 3 or values.shape[2] not in (1, 3, 4):
            _leave_out(name, f"an image of shape {list(values.shape)} cannot be drawn")
            return
        if values.dtype != np.uint8:
            values = np.clip(np.nan_to_num(np.asarray(values, np.float32), nan=0.0), 0.0, 1.0)
        self._write(step, summary=summary.image(name, values, dataformats="HWC"))

    def confusion(
        self, name: str, matrix: Num[Array | np.ndarray, "classes classes"], labels: Sequence[str], step: int
    ) -> None:
        """Log a confusion matrix as an image.

        Args:
            name: Its tag.
            matrix: Counts `[C, C]`, rows the true class, columns the predicted one.
            labels: Names of the C classes.
            step: Step.

        Raises:
            ValueError: If the labels do not match the matrix.
        """
        if not np.size(matrix):
            _leave_out(name, "it has no classes")
            return
        self.image(name, confusion_image(matrix, labels), step)

    def mesh(
        self,
        name: str,
        xyz: Num[Array | np.ndarray, "*b n 3"],
        step: int,
        *,
        color: Num[Array | np.ndarray, "*b n 3"] | None = None,
    ) -> None:
        """Log a cloud `[n, 3]` or a batch `[b, n, 3]`, with colours likewise in 0..255, as rotatable meshes without faces.

        Raises:
            ValueError: If there are colours of another shape.
        """
        from tensorboardX import summary

        points = np.asarray(xyz, np.float32)
        if not points.size:
            _leave_out(name, "it has no points")
            return
        if color is not None and np.shape(color) != points.shape:
            raise ValueError(f"color: expected shape {points.shape}, that of xyz, got {np.shape(color)}")
        batch = (1, *points.shape)[-3:]
        colors = None
        if color is not None:
            colors = np.clip(np.nan_to_num(np.asarray(color, np.float32)), 0, 255).astype(np.uint8).reshape(batch)
        self._write(step, summary=summary.mesh(name, points.reshape(batch), colors, None))

    def flush(self) -> None:
        """Bring everything logged so far to the disk."""
        self._events.flush()

    def close(self) -> None:
        """Write what is left and close the file; a second call does nothing."""
        if not self._closed:
            self._closed = True
            self._events.close()

    def _write(self, step: int, **content: Any) -> None:
        """Append one event.

        Raises:
            ValueError: If the log is closed.
        """
        from tensorboardX.proto.event_pb2 import Event  # pyright: ignore[reportAttributeAccessIssue]

        if self._closed:
            raise ValueError(f"log: expected an open one, got the closed log in {self.folder}")
        self._events.write_event(Event(wall_time=time.time(), step=int(step), **content))

    def __enter__(self) -> "RunLogger":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open_events(folder: Path) -> Any:
    """A new event file, whose name no other log of the same second shares."""
    require("tensorboardX", why="a TensorBoard log")
    from tensorboardX.event_file_writer import EventsWriter

    folder.mkdir(parents=True, exist_ok=True)
    return EventsWriter(str(folder / "events"), f".{secrets.token_hex(4)}")


def _numbers(values: Mapping[str, object]) -> dict[str, float]:
    """The numbers among named values; the others are left out with a warning."""
    found = {}
    for name, value in values.items():
        number = _number(value)
        if number is None:
            _leave_out(name, f"expected one number that float64 holds, got {type(value).__name__} {str(value)[:40]}")
        else:
            found[name] = number
    return found


def _number(value: Any) -> float | None:
    """A number, or an array that holds one, as a float; None for everything else."""
    if value is None or isinstance(value, str | bytes):
        return None
    try:
        array = np.asarray(value)
        return float(array.reshape(())) if array.size == 1 and array.dtype.kind not in "cUSMm" else None
    except (TypeError, ValueError, OverflowError):
        return None


def _setting(value: Any) -> bool | float | str:
    """A setting as the plugin takes it: what JSON has no number for is text."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    number = _number(value)
    return str(value) if number is None or not np.isfinite(number) else number


def _leave_out(name: str, why: str) -> None:
    _warn(f"{name} is left out: {why}")


def _warn(text: str) -> None:
    warnings.warn(f"TensorBoard log: {text}", stacklevel=4)


def confusion_image(matrix: Num[Array | np.ndarray, "classes classes"], labels: Sequence[str]) -> np.ndarray:
    """Draw a confusion matrix, shaded by row share, with its counts written in.

    Args:
        matrix: Counts `[C, C]`, rows the true class.
        labels: Names of the C classes.

    Returns:
        RGB pixels `[height, width, 3]`, uint8.

    Raises:
        ValueError: If the number of labels is not C.
    """
    require("matplotlib", why="a picture of a confusion matrix")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if len(labels) != len(matrix):
        raise ValueError(f"labels: expected {len(matrix)} names, one a class, got {len(labels)}")
    matrix = np.asarray(matrix)
    share = matrix / np.maximum(matrix.sum(1, keepdims=True), 1)
    side = max(4.0, 0.5 * len(labels) + 2.0)
    figure = Figure(figsize=(side, side), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
    axes.set(xlabel="predicted", ylabel="true", xticks=range(len(labels)), yticks=range(len(labels)))
    axes.set_xticklabels(labels, rotation=90)
    axes.set_yticklabels(labels)
    for row, column in np.argwhere(matrix):
        ink = "white" if share[row, column] > 0.5 else "black"
        axes.text(column, row, f"{matrix[row, column]:g}", ha="center", va="center", color=ink, fontsize=8)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
