"""A writer of COPC files, which no library here has: points in an octree, each node a chunk of LAZ, and the hierarchy.

After the COPC specification 1.0. `python -m tests.io.copc_files FILE POINTS` writes a large one for timings.
"""

import io
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

HEADER = 375  # bytes of a LAS 1.4 header; the first record behind it is COPC's
RECORD = 54


def write_copc(
    path: Path, xyz: np.ndarray, *, node_points: int = 200, page: bool = False, withheld: Sequence[int] = (), seed: int = 0
) -> np.ndarray:  # fmt: skip
    """Write points; `page` puts the nodes below the root into a second page of the hierarchy, `withheld` are rows to mark so.

    Returns:
        Row of each point of the file among those given.
    """
    import laspy
    import lazrs

    low, high = xyz.min(axis=0), xyz.max(axis=0)
    centre, half = (low + high) / 2, float((high - low).max()) / 2 * 1.001 + 1e-6
    nodes = _octree(xyz, centre, half, node_points, np.random.default_rng(seed))
    order = np.concatenate([rows for _, rows in nodes])
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets, header.scales = np.round(centre), np.full(3, 1e-4)
    points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
    points.x, points.y, points.z = xyz[order].T
    points.intensity = np.arange(len(xyz)) % 65536
    points["withheld"][list(withheld)] = 1
    laz = lazrs.LazVlr.new_for_compression(6, 0, use_variable_size_chunks=True)
    header.grow(points)
    header.are_points_compressed = True
    header.vlrs.append(laspy.VLR("copc", 1, record_data=bytes(160)))
    header.vlrs.append(laspy.vlrs.known.LasZipVlr(bytes(laz.record_data())))
    out = io.BytesIO()
    header.write_to(out)
    start = out.tell()
    compressor = lazrs.LasZipCompressor(out, laz)
    first = 0
    for _, rows in nodes:
        if first:
            compressor.finish_current_chunk()  # the last one is finished by `done`
        compressor.compress_many(points.array[first : first + len(rows)].view(np.uint8))
        first += len(rows)
    compressor.done()
    out.seek(start)
    table = lazrs.read_chunk_table(out, laz)
    at, entries = start + 8, []
    for (key, rows), (count, size) in zip(nodes, table, strict=True):
        assert count == len(rows)
        entries.append((key, at, size, count))
        at += size
    out.seek(0, io.SEEK_END)
    _write_hierarchy(out, entries, centre, half, page)
    path.write_bytes(out.getvalue())
    return order


def _octree(xyz: np.ndarray, centre: np.ndarray, half: float, most: int, rng: np.random.Generator) -> list[Any]:
    """Nodes with their rows: a random part of those in its cube for each, the rest for its children."""
    todo, nodes = [((0, 0, 0, 0), rng.permutation(len(xyz)))], []
    while todo:
        (level, *cell), rows = todo.pop(int(rng.integers(len(todo))))  # in no order that a reader may lean on
        nodes.append(((level, *cell), rows[:most]))
        rest = rows[most:]
        side = 2 * half / 2 ** (level + 1)
        child = np.floor((xyz[rest] - (centre - half)) / side).astype(int)
        for key in np.unique(child, axis=0):
            todo.append(((level + 1, *key.tolist()), rest[(child == key).all(axis=1)]))
    return nodes


def _write_hierarchy(out: Any, entries: list[Any], centre: np.ndarray, half: float, page: bool) -> None:
    def packed(some: list[Any]) -> bytes:
        return b"".join(struct.pack("<iiiiQii", *key, at, size, count) for key, at, size, count in some)

    start = out.tell()
    pages = packed(entries)
    root_at, root_size = start + 60, len(pages)
    if page:  # the root's own page: its entry and a pointer for each child to one page of all the others
        roots = [entry for entry in entries if entry[0][0] == 0]
        others = [entry for entry in entries if entry[0][0] > 0]
        below = packed(others)
        children = [(key, start + 60, len(below), -1) for key, *_ in others if key[0] == 1]
        root = packed([*roots, *children])
        pages, root_at, root_size = below + root, start + 60 + len(below), len(root)
    out.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(pages), b"EPT Hierarchy") + pages)
    out.seek(HEADER + RECORD)
    out.write(struct.pack("<dddddQQdd", *centre, half, half / 64, root_at, root_size, 0.0, 0.0))
    out.seek(235)  # start of the first extended record, and how many there are
    out.write(struct.pack("<QI", start, 1))


if __name__ == "__main__":
    from tests.reference.circles import bent_cable

    write_copc(Path(sys.argv[1]), bent_cable(n=int(sys.argv[2])), node_points=50_000)
