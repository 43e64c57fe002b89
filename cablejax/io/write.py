"""Write clouds as PLY, PCD, XYZ, TXT, CSV, LAS or LAZ, whole or not at all."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Array, Num

from cablejax.io.atomic import atomic_write
from cablejax.io.child import FLOAT_INTENSITY
from cablejax.io.points import unit_scale
from cablejax.io.raw import BadFile, PointFileError, as_uint8, as_uint16

LARGEST_INT32 = 2**31 - 1


def write_points(
    path: str | os.PathLike[str],
    xyz_mm: Num[Array | np.ndarray, "n 3"],
    *,
    unit: str = "mm",
    color: Num[Array | np.ndarray, "n 3"] | None = None,
    intensity: Num[Array | np.ndarray, " n"] | None = None,
) -> None:
    """Write a cloud in one step; a killed or failed write leaves the old file.

    PLY and text hold float64 coordinates and give back the same numbers. LAS and LAZ hold multiples of a step of 1e-6
    units, or of the smallest power of ten that fits the cloud's extent into 32 bits. PCD holds float32, the only type
    that its usual readers take, and refuses a cloud so far from the origin that this would show.

    Args:
        path: Its ending chooses the format: .ply, .pcd, .xyz, .txt, .csv, .las or .laz.
        xyz_mm: Coordinates `[n, 3]`, mm, finite.
        unit: Unit of the numbers in the file, as for `read_points`.
        color: Red, green, blue `[n, 3]`, uint8 or uint16.
        intensity: `[n]`. LAS and LAZ hold whole numbers to 65535; others go into an extra dimension.

    Raises:
        ValueError: If the cloud is empty or holds NaN, the arrays differ in length, or `unit` or a type is wrong.
        PointFileError: If the ending is unknown or the file cannot be written; the old file is untouched.

    Example:
        >>> import tempfile
        >>> from cablejax.io import read_points
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_points(f"{folder}/a.ply", np.array([[0.0, 1.0, 0.1]]))
        ...     read_points(f"{folder}/a.ply").xyz_mm.tolist()
        [[0.0, 1.0, 0.1]]
    """
    path = Path(path)
    xyz, color, intensity = _checked(xyz_mm, color, intensity, unit_scale(unit))
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise PointFileError(path, f"has an ending that cannot be written; known are {', '.join(WRITERS)}")
    try:
        with atomic_write(path) as file:
            writer(file, xyz, color, intensity)
    except BadFile as error:
        raise PointFileError(path, str(error)) from error
    except OSError as error:
        raise PointFileError(path, f"cannot be written ({error.strerror or error})") from error


def _checked(
    xyz_mm: object, color: object, intensity: object, scale: float
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """The arrays as NumPy, coordinates in the file's unit."""
    xyz = np.asarray(xyz_mm, np.float64) / scale
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) == 0:
        raise ValueError(f"xyz_mm: expected shape [n, 3] with n at least 1, got {list(xyz.shape)}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"xyz_mm: expected finite coordinates, got {(~np.isfinite(xyz)).any(1).sum()} rows with NaN")
    if color is not None:
        color = np.asarray(color)
        if color.shape != xyz.shape or color.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"color: expected uint8 or uint16 {list(xyz.shape)}, got {color.dtype} {list(color.shape)}"
            )
    if intensity is not None:
        intensity = np.asarray(intensity, np.float32)
        if intensity.shape != xyz.shape[:1]:
            raise ValueError(f"intensity: expected shape [{len(xyz)}], got {list(intensity.shape)}")
    return xyz, color, intensity


def _write_ply(file: BinaryIO, xyz: np.ndarray, color: np.ndarray | None, intensity: np.ndarray | None) -> None:
    kinds = {"<f8": "double", "<f4": "float", "u1": "uchar", "<u2": "ushort"}
    fields = [(axis, "<f8") for axis in "xyz"]
    if color is not None:
        fields += [(name, "u1" if color.dtype == np.uint8 else "<u2") for name in ("red", "green", "blue")]
    if intensity is not None:
        fields += [("intensity", "<f4")]
    lines = ["ply", "format binary_little_endian 1.0", "comment written by cablejax", f"element vertex {len(xyz)}"]
    lines += [f"property {kinds[kind]} {name}" for name, kind in fields]
    file.write(("\n".join([*lines, "end_header"]) + "\n").encode())
    file.write(_records(fields, xyz, color, intensity).tobytes())


def _write_pcd(file: BinaryIO, xyz: np.ndarray, color: np.ndarray | None, intensity: np.ndarray | None) -> None:
    _check_float32(xyz)
    fields, packed = [(axis, "<f4") for axis in "xyz"], None
    if color is not None:
        wide = as_uint8(color).astype(np.uint32)
        packed = (wide[:, :1] << 16) | (wide[:, 1:2] << 8) | wide[:, 2:]
        fields += [("rgb", "<u4")]
    if intensity is not None:
        fields += [("intensity", "<f4")]
    kinds = {"<f4": ("4", "F"), "<u4": ("4", "U")}
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _ in fields),
        "SIZE " + " ".join(kinds[kind][0] for _, kind in fields),
        "TYPE " + " ".join(kinds[kind][1] for _, kind in fields),
        "COUNT " + " ".join("1" for _ in fields),
        f"WIDTH {len(xyz)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(xyz)}", "DATA binary",
    ]  # fmt: skip
    file.write(("\n".join(lines) + "\n").encode())
    file.write(_records(fields, xyz, packed, intensity).tobytes())


def _check_float32(xyz: np.ndarray) -> None:
    """PCL and Open3D read float32 coordinates alone: a cloud that they would round visibly is refused."""
    step = float(np.spacing(np.abs(xyz).max().astype(np.float32)))
    extent = float(np.ptp(xyz, axis=0).max())
    if step > max(extent, 1.0) * 1e-5:
        raise BadFile(
            f"cannot be written: PCD readers take float32, whose step here is {step:.2g} units in a cloud {extent:.2g} units "
            "wide; shift the cloud, or write PLY or LAZ"
        )


def _records(
    fields: list[tuple[str, str]], xyz: np.ndarray, color: np.ndarray | None, intensity: np.ndarray | None
) -> np.ndarray:
    """Columns as records, in the order of `fields`."""
    columns = [*xyz.T, *(() if color is None else color.T), *(() if intensity is None else (intensity,))]
    rows = np.empty(len(xyz), np.dtype(fields))
    for (name, _), column in zip(fields, columns, strict=True):
        rows[name] = column
    return rows


def _text_writer(delimiter: str, mark: str) -> Callable[..., None]:
    """A writer of tables whose first line names the columns; the shortest digits that give back the same number."""

    def write(file: BinaryIO, xyz: np.ndarray, color: np.ndarray | None, intensity: np.ndarray | None) -> None:
        names, columns = ["x", "y", "z"], [map(repr, column.tolist()) for column in xyz.T]
        if color is not None:
            names += ["red", "green", "blue"]
            columns += [map(str, column.tolist()) for column in color.T]
        if intensity is not None:
            names += ["intensity"]
            columns += [map(str, intensity)]
        file.write((mark + delimiter.join(names) + "\n").encode())
        for row in zip(*columns, strict=True):
            file.write((delimiter.join(row) + "\n").encode())

    return write


def _las_writer(compressed: bool) -> Callable[..., None]:
    """A writer of LAS 1.4, point format 6, or 7 with colours."""

    def write(file: BinaryIO, xyz: np.ndarray, color: np.ndarray | None, intensity: np.ndarray | None) -> None:
        try:
            import laspy
        except ImportError as error:
            raise OSError(f"LAS and LAZ need laspy: pip install 'cablejax[scan]' ({error})") from error

        header = laspy.LasHeader(version="1.4", point_format=6 if color is None else 7)
        header.offsets = np.round((xyz.min(0) + xyz.max(0)) / 2)
        extent = max(float(np.abs(xyz - header.offsets).max()), 1e-9)
        header.scales = np.full(3, max(1e-6, 10.0 ** np.ceil(np.log10(extent / LARGEST_INT32))))
        whole = intensity is None or bool(((intensity >= 0) & (intensity <= 65535) & (intensity % 1 == 0)).all())
        if not whole:
            header.add_extra_dim(laspy.ExtraBytesParams(FLOAT_INTENSITY, "f4"))
        points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
        points.x, points.y, points.z = xyz.T
        if color is not None:
            points.red, points.green, points.blue = as_uint16(color).T
        if intensity is not None:
            points["intensity" if whole else FLOAT_INTENSITY] = intensity
        with laspy.LasWriter(file, header, do_compress=compressed, closefd=False) as writer:
            writer.write_points(points)

    return write


WRITERS: dict[str, Callable[[BinaryIO, np.ndarray, np.ndarray | None, np.ndarray | None], None]] = {
    ".ply": _write_ply, ".pcd": _write_pcd, ".xyz": _text_writer(" ", "# "), ".txt": _text_writer(" ", "# "),
    ".csv": _text_writer(",", ""), ".las": _las_writer(compressed=False), ".laz": _las_writer(compressed=True),
}  # fmt: skip
