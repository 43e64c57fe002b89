"""The written formats: each takes points piece by piece and completes its header at the end."""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from cablejax.io.child import FLOAT_INTENSITY
from cablejax.io.raw import BadFile, RawCloud, as_uint8, as_uint16

LARGEST_INT32 = 2**31 - 1
# Counts have room for this many digits, so that a header keeps its length when the count is known at last.
COUNT_DIGITS = 20
FLOAT32_STEP = 1e-5


class RecordSink(ABC):
    """Binary records behind a header that states their number: what PLY and PCD share."""

    def __init__(self, file: BinaryIO, first: RawCloud):
        self.file = file
        self.fields = self.record(first)
        self.n = 0
        file.write(self.header(0))

    @abstractmethod
    def record(self, first: RawCloud) -> list[tuple[str, str]]:
        """Names and NumPy types of a record's fields."""

    @abstractmethod
    def header(self, n: int) -> bytes:
        """The header for n points; its length does not depend on n."""

    def color_columns(self, color: np.ndarray) -> np.ndarray:
        """The colour fields, one a row."""
        return color.T

    def append(self, cloud: RawCloud) -> None:
        """Write points after those already there."""
        columns = [*cloud.xyz.T]
        if cloud.color is not None:
            columns += [*self.color_columns(cloud.color)]
        if cloud.intensity is not None:
            columns += [cloud.intensity]
        rows = np.empty(len(cloud.xyz), np.dtype(self.fields))
        for (name, _), column in zip(self.fields, columns, strict=True):
            rows[name] = column
        self.file.write(rows.tobytes())
        self.n += len(rows)

    def finish(self) -> None:
        """Write the header again, now with the number of points."""
        self.file.seek(0)
        self.file.write(self.header(self.n))


class PlySink(RecordSink):
    """PLY, binary little-endian, float64 coordinates."""

    kinds = {"<f8": "double", "<f4": "float", "u1": "uchar", "<u2": "ushort"}  # noqa: RUF012 (never changed)

    def record(self, first: RawCloud) -> list[tuple[str, str]]:
        fields = [(axis, "<f8") for axis in "xyz"]
        if first.color is not None:
            fields += [(name, "u1" if first.color.dtype == np.uint8 else "<u2") for name in ("red", "green", "blue")]
        return [*fields, *([("intensity", "<f4")] if first.intensity is not None else [])]

    def header(self, n: int) -> bytes:
        room = " " * (COUNT_DIGITS - len(str(n)))
        lines = ["ply", "format binary_little_endian 1.0", f"comment written by cablejax{room}", f"element vertex {n}"]
        lines += [f"property {self.kinds[kind]} {name}" for name, kind in self.fields]
        return ("\n".join([*lines, "end_header"]) + "\n").encode()


class PcdSink(RecordSink):
    """PCD, binary, float32 coordinates: PCL and Open3D read no other (Open3D 0.20 takes float64 fields for zeros)."""

    def record(self, first: RawCloud) -> list[tuple[str, str]]:
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        fields = [(axis, "<f4") for axis in "xyz"]
        fields += [("rgb", "<u4")] if first.color is not None else []
        return [*fields, *([("intensity", "<f4")] if first.intensity is not None else [])]

    def header(self, n: int) -> bytes:
        room = " " * (2 * (COUNT_DIGITS - len(str(n))))
        kinds = {"<f4": ("4", "F"), "<u4": ("4", "U")}
        lines = [
            "# .PCD v0.7 - Point Cloud Data file format",
            f"# written by cablejax{room}",
            "VERSION 0.7",
            "FIELDS " + " ".join(name for name, _ in self.fields),
            "SIZE " + " ".join(kinds[kind][0] for _, kind in self.fields),
            "TYPE " + " ".join(kinds[kind][1] for _, kind in self.fields),
            "COUNT " + " ".join("1" for _ in self.fields),
            f"WIDTH {n}",
            "HEIGHT 1",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {n}",
            "DATA binary",
        ]
        return ("\n".join(lines) + "\n").encode()

    def color_columns(self, color: np.ndarray) -> np.ndarray:
        red, green, blue = as_uint8(color).astype(np.uint32).T
        return ((red << 16) | (green << 8) | blue)[None]

    def append(self, cloud: RawCloud) -> None:
        self.low = np.minimum(self.low, cloud.xyz.min(axis=0))
        self.high = np.maximum(self.high, cloud.xyz.max(axis=0))
        super().append(cloud)

    def finish(self) -> None:
        """Complete the file, unless float32 has rounded the cloud visibly.

        Raises:
            BadFile: If float32's step is beyond `FLOAT32_STEP` of the cloud's width.
        """
        step = float(np.spacing(np.float32(max(np.abs(self.low).max(), np.abs(self.high).max()))))
        width = float((self.high - self.low).max())
        if step > FLOAT32_STEP * max(width, 1.0):
            raise BadFile(
                f"cannot be written: PCD readers take float32, whose step here is {step:.2g} units in a cloud "
                f"{width:.2g} units wide; shift the cloud, or write PLY or LAZ"
            )
        super().finish()


class TextSink:
    """A table whose first line names the columns; the shortest digits that give back the same numbers."""

    delimiter, mark = " ", "# "

    def __init__(self, file: BinaryIO, first: RawCloud):
        self.file = file
        names = ["x", "y", "z", *(("red", "green", "blue") if first.color is not None else ())]
        names += ["intensity"] if first.intensity is not None else []
        file.write((self.mark + self.delimiter.join(names) + "\n").encode())

    def append(self, cloud: RawCloud) -> None:
        """Write points after those already there."""
        columns = [map(repr, column.tolist()) for column in cloud.xyz.T]
        if cloud.color is not None:
            columns += [map(str, column.tolist()) for column in cloud.color.T]
        if cloud.intensity is not None:
            columns += [map(str, cloud.intensity)]
        lines = map(self.delimiter.join, zip(*columns, strict=True))
        self.file.write(("\n".join(lines) + "\n").encode())

    def finish(self) -> None:
        """Nothing is left to do."""


class CsvSink(TextSink):
    """A table with commas."""

    delimiter, mark = ",", ""


class LasSink:
    """LAS 1.4, point format 6, or 7 with colours: coordinates as 32-bit multiples of a step from an origin.

    Args:
        file: Where to.
        first: The first piece: it decides about colours, the kind of intensity and the origin.
        compressed: LAZ instead of LAS.
        step: Step of the coordinates, in the file's unit.
    """

    def __init__(self, file: BinaryIO, first: RawCloud, *, compressed: bool, step: float):
        try:
            import laspy
        except ImportError as error:
            raise BadFile(f"needs a package that is missing ({error.name}): pip install 'cablejax[scan]'") from error
        self.header = laspy.LasHeader(version="1.4", point_format=6 if first.color is None else 7)
        self.header.offsets = np.round((first.xyz.min(axis=0) + first.xyz.max(axis=0)) / 2)
        self.header.scales = np.full(3, step)
        self.whole = first.intensity is None or is_whole(first.intensity)
        if not self.whole:
            self.header.add_extra_dim(laspy.ExtraBytesParams(FLOAT_INTENSITY, "f4"))
        self.writer = laspy.LasWriter(file, self.header, do_compress=compressed, closefd=False)

    def append(self, cloud: RawCloud) -> None:
        """Write points after those already there.

        Raises:
            BadFile: If a point is too far for 32 bits, or intensities turn out to be no whole numbers.
        """
        import laspy

        reach = float(np.abs(cloud.xyz - self.header.offsets).max())
        if reach > LARGEST_INT32 * self.header.scales[0]:
            raise BadFile(f"cannot be written: a point is {reach:.6g} units from the first piece's middle, too far for a "
                          f"step of {self.header.scales[0]:g} units; choose a larger step")  # fmt: skip
        points = laspy.ScaleAwarePointRecord.zeros(len(cloud.xyz), header=self.header)
        points.x, points.y, points.z = cloud.xyz.T
        if cloud.color is not None:
            points.red, points.green, points.blue = as_uint16(cloud.color).T
        if cloud.intensity is not None:
            if self.whole and not is_whole(cloud.intensity):
                raise BadFile(
                    "cannot be written: the first intensities were whole numbers up to 65535, later ones are not"
                )
            points["intensity" if self.whole else FLOAT_INTENSITY] = cloud.intensity
        with native_errors():
            self.writer.write_points(points)

    def finish(self) -> None:
        """Write the chunk table and the final header."""
        with native_errors():
            self.writer.close()


@contextlib.contextmanager
def native_errors() -> Iterator[None]:
    """lazrs reports a failed write as a RuntimeError of its own."""
    try:
        yield
    except RuntimeError as error:
        raise BadFile(f"cannot be written ({error})") from error


def is_whole(intensity: np.ndarray) -> bool:
    """Whether intensities fit LAS's own field: whole numbers of 16 bits."""
    return bool(((intensity >= 0) & (intensity <= 65535) & (intensity % 1 == 0)).all())


def las_step(xyz: np.ndarray) -> float:
    """The finest step from 1e-6 of the unit up, a power of ten, with which a cloud fits 32 bits."""
    middle = np.round((xyz.min(axis=0) + xyz.max(axis=0)) / 2)
    reach = max(float(np.abs(xyz - middle).max()), 1e-9)
    return max(1e-6, float(10.0 ** np.ceil(np.log10(reach / LARGEST_INT32))))
