"""Readers of LAS, LAZ, COPC and E57: run as a script in a process of their own, for their libraries are native code.

On damaged files that code can loop, abort, or ask for terabytes. This file imports NumPy and the one library it needs
and nothing of cablejax, so that the process starts quickly. `python child.py las|copc|e57 FILE MEMORY_BYTES POINTS` writes
the points to standard output, piece by piece: a line of JSON that describes the arrays, then their bytes; last a line
that holds nothing but the error or null. A piece waits until the one before it was taken. For copc six numbers follow,
the corners of a box: the points within it alone, with their rows in the file.
"""

import importlib
import json
import os
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, BinaryIO

import numpy as np

CHUNK_BYTES = 64 * 2**20
VLR_BYTES = 54  # the header of a variable length record
E57_POINTS = 1_000_000
FLOAT_INTENSITY = "intensity_f32"
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
COLORS = ("colorRed", "colorGreen", "colorBlue")

Chunk = dict[str, Any]


class Damaged(Exception):
    """Why a file cannot be read."""


def las_chunks(path: str, size: int | None = None) -> Iterator[Chunk]:
    """Read a LAS, LAZ or COPC file piece by piece, without withheld points.

    Args:
        path: The file.
        size: Points a piece; about `CHUNK_BYTES` where it is None.

    Yields:
        `xyz` `[m, 3]` float64, `color` `[m, 3]` uint16 or None, `intensity` `[m]` float32, `dropped`.

    Raises:
        Damaged: If the header promises more or fewer points than there are.
    """
    with open(path, "rb") as file:
        reader, held = _las_reader(file)
        header = reader.header
        promised, width = header.point_count, header.point_format.size
        names = set(header.point_format.dimension_names)
        read = 0
        step = size or max(1, CHUNK_BYTES // max(width, 1))
        while read < held and len(points := reader.read_points(min(step, held - read))):
            read += len(points)
            yield _las_chunk(points, names)
        if read != held:
            raise Damaged(f"is truncated: its header promises {promised:,} points, {read:,} are there")
        if held < promised:
            yield _note(f"its header promises {promised:,} points, {held:,} are there and were read")


def _las_reader(file: BinaryIO) -> tuple[Any, int]:
    """laspy's reader at the first point, and how many points to read.

    Raises:
        Damaged: If the header cannot be right.
    """
    import laspy

    _check_las_header(file)
    reader = laspy.LasReader(file, laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False)
    header = reader.header
    held = _check_las_count(file, header)
    if not (np.isfinite(header.scales).all() and np.isfinite(header.offsets).all() and np.all(header.scales != 0)):
        raise Damaged("has a damaged header: its scales or offsets are no numbers")
    return reader, held


def copc_chunks(path: str, size: int | None, low: np.ndarray, high: np.ndarray) -> Iterator[Chunk]:
    """Read the points of a COPC file within a box, decoding no node that lies outside.

    Args:
        path: The file.
        size: Most points a piece; a node a piece where it is None.
        low, high: Corners of the box `[3]`, in the file's unit; points on its sides are within.

    Yields:
        As `las_chunks`, with `row` `[m]` int64, the place of each point in the file.

    Raises:
        Damaged: If the hierarchy does not tell where the points are.
    """
    with open(path, "rb") as file:
        reader, held = _las_reader(file)
        header, names = reader.header, set(reader.header.point_format.dimension_names)
        nodes = _copc_nodes(file)
        if sum(node.point_count for node in nodes) != held:
            raise Damaged("has a damaged hierarchy: it does not hold all points")
        first, touched = 0, _touching(low, high, np.abs(header.scales))
        for node in nodes:
            if touched(node):
                points = _node_points(file, node, header)
                step = size or len(points)
                for start in range(0, len(points), step):
                    yield _within(_las_chunk(points[start : start + step], names), first + start, low, high)
            first += node.point_count


def _copc_nodes(file: BinaryIO) -> list[Any]:
    """All nodes of a COPC file that hold points, in the order of the file, which is that of its rows."""
    from laspy import copc

    file.seek(0)
    reader = copc.CopcReader(file)
    _read_pages(file, reader.root_page)
    nodes = copc.load_octree_for_query(file, reader.copc_info, reader.root_page)
    return sorted((node for node in nodes if node.point_count), key=lambda node: node.offset)


def _read_pages(file: BinaryIO, page: Any) -> None:
    """Put all pages of a hierarchy into the first; laspy follows one that leads to itself without end.

    Raises:
        Damaged: If an entry leads to a page that does not hold it.
    """
    from laspy import copc

    followed = set()
    while pointers := [entry for entry in page.entries.values() if entry.point_count == -1]:
        for entry in pointers:
            if entry.key in followed:
                raise Damaged("has a damaged hierarchy: an entry leads to a page that does not hold it")
            followed.add(entry.key)
            file.seek(entry.offset)
            page.entries.update(copc.HierarchyPage.from_bytes(file.read(entry.byte_size)).entries)


def _touching(low: np.ndarray, high: np.ndarray, step: np.ndarray) -> Callable[[Any], bool]:
    """Whether a node's cube touches a box; coordinates are rounded to a step, and so may leave their cube by one."""
    return lambda node: bool(np.all((node.bounds.mins <= high + step) & (node.bounds.maxs >= low - step)))


def _node_points(file: BinaryIO, node: Any, header: Any) -> Any:
    """The points of a node, decoded by themselves."""
    import laspy

    lazrs: Any = importlib.import_module("lazrs")
    file.seek(node.offset)
    data = file.read(node.byte_size)
    raw = np.zeros(node.point_count * header.point_format.size, dtype=np.uint8)
    laz = header.vlrs.get("LasZipVlr")[0].record_data
    every = laspy.DecompressionSelection.all().to_lazrs()
    lazrs.decompress_points_with_chunk_table(data, laz, raw, [(node.point_count, node.byte_size)], every)
    packed = laspy.PackedPointRecord.from_buffer(raw, header.point_format)
    return laspy.ScaleAwarePointRecord(packed.array, packed.point_format, header.scales, header.offsets)


def _within(chunk: Chunk, first: int, low: np.ndarray, high: np.ndarray) -> Chunk:
    """The points of a piece in a box, with their rows."""
    if chunk["dropped"]:
        raise Damaged("holds withheld points, so that rows cannot be told")
    keep = ((chunk["xyz"] >= low) & (chunk["xyz"] <= high)).all(axis=1)
    arrays = {name: value[keep] for name, value in chunk.items() if isinstance(value, np.ndarray)}
    return {**arrays, "dropped": 0, "row": first + np.flatnonzero(keep)}


def _note(text: str) -> Chunk:
    """A piece without points that has something to say."""
    return {"xyz": np.zeros((0, 3)), "dropped": 0, "notes": [text]}


def _check_las_header(file: BinaryIO) -> None:
    """Refuse a number of records that would not fit into the file, before laspy goes through them."""
    size, head = os.fstat(file.fileno()).st_size, file.read(104)
    header_size, start, records = struct.unpack("<HII", head[94:104]) if len(head) == 104 else (0, size + 1, 0)
    if header_size + VLR_BYTES * records > size or start > size:
        raise Damaged(f"is damaged or truncated: its header promises {records:,} records, points from byte {start:,}")
    file.seek(0)


def _check_las_count(file: BinaryIO, header: Any) -> int:
    """Compare the number of points in the header with what the file can hold, or says elsewhere that it holds.

    Returns:
        How many points to read: those promised, or one less where an uncompressed file just lacks its last.
    """
    promised, width = header.point_count, header.point_format.size
    if header.are_points_compressed:
        _check_laz_count(file, header)
        return promised
    ends = [os.fstat(file.fileno()).st_size, header.start_of_waveform_data_packet_record]
    ends += [header.start_of_first_evlr] if header.number_of_evlrs else []
    held, rest = divmod(min(end for end in ends if end) - header.offset_to_point_data, width)
    if held < promised and (rest or held < max(promised - 1, 1)):
        raise Damaged(f"is truncated: its header promises {promised:,} points, {max(0, held):,} are there")
    if held > promised and not _is_padding(file, header.offset_to_point_data + promised * width):
        raise Damaged(f"holds {held:,} points, more than the {promised:,} of its header")
    return min(held, promised)


def _is_padding(file: BinaryIO, start: int) -> bool:
    """Whether nothing but zeros stands at the end of a file."""
    back = file.tell()
    file.seek(start)
    empty = True
    while empty and (data := file.read(CHUNK_BYTES)):
        empty = not data.strip(b"\0")
    file.seek(back)
    return empty


def _check_laz_count(file: BinaryIO, header: Any) -> None:
    """The table of compressed chunks says how many points there are, to a chunk or exactly."""
    lazrs: Any = importlib.import_module("lazrs")

    laz = lazrs.LazVlr(header.vlrs.get("LasZipVlr")[0].record_data)
    back = file.tell()
    file.seek(header.offset_to_point_data)
    try:
        table = lazrs.read_chunk_table(file, laz)
    except lazrs.LazrsError:
        return  # a file written to a pipe has none; reading the points tells
    finally:
        file.seek(back)
    held = sum(count for count, _ in table)
    chunk = 1 if laz.uses_variable_size_chunks() else laz.chunk_size()
    if not held - chunk < header.point_count <= held:
        raise Damaged(f"is damaged: its header promises {header.point_count:,} points, its chunks hold {held:,}")


def _las_chunk(points: Any, names: set[str]) -> Chunk:
    keep = np.ones(len(points), bool)
    if "withheld" in names:
        keep = np.asarray(points["withheld"]) == 0
    xyz = np.stack([np.asarray(points[axis], np.float64) for axis in "xyz"], axis=1)[keep]
    color = None
    if {"red", "green", "blue"} <= names:
        color = np.stack([np.asarray(points[name], np.uint16) for name in ("red", "green", "blue")], axis=1)[keep]
    name = FLOAT_INTENSITY if FLOAT_INTENSITY in names else "intensity"
    intensity = np.asarray(points[name], np.float32)[keep]
    return {"xyz": xyz, "color": color, "intensity": intensity, "dropped": int((~keep).sum())}


def e57_chunks(path: str, size: int | None = None) -> Iterator[Chunk]:
    """Read every scan of an E57 file piece by piece, moved by its pose, without invalid returns.

    Yields:
        `xyz` `[m, 3]` float64 in metres, `color` `[m, 3]` or None, `intensity` `[m]` or None, `dropped`.

    Raises:
        Damaged: If a scan has no coordinates, or fewer points than its header promises.
    """
    import pye57

    file = pye57.E57(path)
    for index in range(file.scan_count):
        yield from _e57_scan(file, file.get_header(index), size or E57_POINTS)


def _e57_scan(file: Any, header: Any, size: int) -> Iterator[Chunk]:
    from pye57 import libe57  # pyright: ignore[reportAttributeAccessIssue]

    available = set(header.point_fields)
    axes = CARTESIAN if set(CARTESIAN) <= available else SPHERICAL
    if not set(axes) <= available:
        raise Damaged("has a scan without coordinates")
    invalid = {"cartesianInvalidState", "sphericalInvalidState"} & available
    fields = [*axes, *invalid, *(COLORS if set(COLORS) <= available else ()), *({"intensity"} & available)]
    if header.has_pose():
        _check_rotation(header.rotation_matrix)
    promised, read = header.point_count, 0
    size = max(1, min(size, promised))
    buffers = libe57.VectorSourceDestBuffer()
    columns = {name: np.empty(size, np.float64) for name in fields}
    for name, column in columns.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, name, column, size, True, True))
    if promised:
        reader = header.points.reader(buffers)
        while count := reader.read():
            read += count
            yield _e57_chunk({name: column[:count].copy() for name, column in columns.items()}, axes, invalid, header)
        reader.close()
    if read != promised:
        raise Damaged(f"is truncated: its header promises {promised:,} points, {read:,} are there")


def _check_rotation(rotation: np.ndarray) -> None:
    """Refuse a pose that does more than turn: its quaternion is not of length 1, and the points would go astray."""
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off < 1e-3:
        raise Damaged(f"has a scan whose pose is off a rotation by {off:.2g}, so that its points cannot be placed")


def _e57_chunk(columns: dict[str, np.ndarray], axes: tuple[str, ...], invalid: set[str], header: Any) -> Chunk:
    keep = np.ones(len(columns[axes[0]]), bool)
    for name in invalid:
        keep &= columns[name] == 0
    at_scanner = ~np.any([columns[name] for name in (axes if axes is CARTESIAN else axes[:1])], axis=0)
    if np.count_nonzero(at_scanner & keep) > 1:  # beams without return, as some scanners write them
        keep &= ~at_scanner
    a, b, c = (columns[name][keep] for name in axes)
    xyz = np.stack([a, b, c], axis=1)
    if axes is SPHERICAL:
        xyz = np.stack([a * np.cos(c) * np.cos(b), a * np.cos(c) * np.sin(b), a * np.sin(c)], axis=1)
    if header.has_pose():
        xyz = xyz @ header.rotation_matrix.T + header.translation
    color, notes = None, []
    if set(COLORS) <= columns.keys():
        color, notes = _e57_color(np.stack([columns[name][keep] for name in COLORS], axis=1), header)
    intensity = columns["intensity"][keep].astype(np.float32) if "intensity" in columns else None
    return {"xyz": xyz, "color": color, "intensity": intensity, "dropped": int((~keep).sum()), "notes": notes}


CHUNKS = {"las": las_chunks, "copc": copc_chunks, "e57": e57_chunks}


def _e57_color(values: np.ndarray, header: Any) -> tuple[np.ndarray | None, list[str]]:
    """Colours as the limits in the scan's header say: shares of 1, 8 bits or 16 bits; 16 bits where it says nothing.

    Returns:
        The colours, or None and what is to be said where some are outside the limits.
    """
    limits = header.node["colorLimits"] if header.node.isDefined("colorLimits") else None
    names = [f"{name}Maximum" for name in COLORS]
    known = [] if limits is None else [limits[name].value() for name in names if limits.isDefined(name)]
    largest = max(known, default=65535)
    scale, kind = (255.0, np.uint8) if largest <= 1 else (1.0, np.uint8 if largest <= 255 else np.uint16)
    values = np.round(values * scale)
    if not ((values >= 0) & (values <= np.iinfo(kind).max)).all():
        return None, [f"its colours are left out: they hold numbers outside their limits of 0 to {largest:g}"]
    return values.astype(kind), []


def main(kind: str, path: str, memory_bytes: int, size: int, out: BinaryIO, box: Sequence[float] = ()) -> None:
    """Send the pieces of a file, and an end that holds the error, if any. A size of 0 leaves it to the reader."""
    limit_memory(memory_bytes)
    error = None
    corners = (np.array(box[:3]), np.array(box[3:])) if box else ()
    try:
        for chunk in CHUNKS[kind](path, size or None, *corners):
            send(out, chunk)
    except BaseException as failure:  # noqa: BLE001 (a panic in native code is no Exception)
        error = reason(failure)
    out.write(json.dumps({"error": error}).encode() + b"\n")
    out.flush()


def send(out: BinaryIO, chunk: Chunk) -> None:
    """Write one piece: its description, then the bytes of its arrays."""
    arrays = {name: np.ascontiguousarray(value) for name, value in chunk.items() if isinstance(value, np.ndarray)}
    described = {name: [value.dtype.str, list(value.shape)] for name, value in arrays.items()}
    head = {"dropped": chunk["dropped"], "notes": chunk.get("notes", []), "arrays": described}
    out.write(json.dumps(head).encode() + b"\n")
    for value in arrays.values():
        out.write(value.tobytes())
    out.flush()


def reason(error: BaseException) -> str:
    """A failure in one clause, to stand after the path."""
    if isinstance(error, Damaged):
        return str(error)
    if isinstance(error, ImportError):
        return f"needs a package that is missing ({error.name}): pip install 'cablejax[scan]'"
    if isinstance(error, MemoryError):
        return "is damaged, or larger than this machine's memory"
    text = " ".join(str(error).split("****")[0].split())  # libE57 says it again below, with file names
    return f"is damaged or truncated ({text[:160] or type(error).__name__})"


def limit_memory(memory_bytes: int) -> None:
    """Let a damaged length fail in this process instead of taking the machine, or the program that waits, down."""
    try:
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write("1000")
    except OSError:
        pass  # not Linux
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, ValueError, OSError):
        return  # Windows, or a tighter limit set from outside


def own_output() -> BinaryIO:
    """Standard output for the points alone: what the libraries print goes nowhere."""
    out = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    return out


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), own_output(), [float(x) for x in sys.argv[5:]])
