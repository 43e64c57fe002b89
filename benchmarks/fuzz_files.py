"""The good files that `fuzz_readers.py` damages: every format and dialect, sixty points each."""

import gzip
import os
import struct
from pathlib import Path

import numpy as np

from cablejax.io import write_points


def base_files(folder: Path) -> dict[str, Path]:
    """Good files of every format and dialect, a few dozen points each."""
    rng = np.random.default_rng(0)
    xyz, color = rng.normal(scale=40.0, size=(60, 3)), rng.integers(0, 256, (60, 3)).astype(np.uint8)
    intensity = rng.integers(0, 4096, 60).astype(np.float32)
    files = {}
    for ending in ("ply", "pcd", "xyz", "csv", "las", "laz"):
        files[ending] = folder / f"base.{ending}"
        write_points(files[ending], xyz, color=color, intensity=intensity)
    rows = [" ".join(f"{value:.4f}" for value in row) for row in xyz]
    body = "\n".join(rows) + "\n"
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    pcd = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA "
    pose = "60\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n"
    columns = xyz.T.astype("<f4").tobytes()
    packed = b"".join(
        bytes([len(part) - 1]) + part for part in (columns[i : i + 32] for i in range(0, len(columns), 32))
    )
    sizes = np.array([len(packed), len(columns)], "<u4").tobytes()
    written: dict[str, bytes] = {
        "ascii.ply": f"ply\nformat ascii 1.0\nelement vertex 60\n{properties}end_header\n{body}".encode(),
        "ascii.pcd": f"{pcd}ascii\n{body}".encode(),
        "compressed.pcd": f"{pcd}binary_compressed\n".encode() + sizes + packed,
        "pts": f"60\n{body}".encode(),
        "ptx": (pose + "\n".join(f"{row} 0.5" for row in rows) + "\n").encode(),
        "obj": "".join(f"v {row}\n" for row in rows).encode(),
        "ply.gz": gzip.compress(files["ply"].read_bytes(), mtime=0),
    }
    for name, content in written.items():
        files[name] = folder / f"base.{name}"
        files[name].write_bytes(content)
    odd = _odd_files(xyz, color)
    for name, content in odd.items():
        files[name] = folder / f"base.{name}"
        files[name].write_bytes(content)
    files["e57"] = _e57(folder / "base.e57", xyz, color)
    still = np.where(np.arange(60)[:, None] % 10 == 0, 0.0, xyz)  # some beams came back with nothing
    files["pose.e57"] = _e57(folder / "base.pose.e57", still, color, translation=np.array([5.0, 6.0, 7.0]))
    return files | _real_files()


def _odd_files(xyz: np.ndarray, color: np.ndarray) -> dict[str, bytes]:
    """Dialects: lists and padding, comments and counts, units and columns by name, missing values in their spellings."""
    rows = [[f"{value:.4f}" for value in row] for row in xyz]
    body = "\n".join(" ".join(row) for row in rows) + "\n"
    lists = "".join(f"{' '.join(row)} {i % 4} {'7 ' * (i % 4)}{i % 2}\n" for i, row in enumerate(rows))
    packed = b"".join(
        struct.pack("<3fB", *row, i % 4) + b"\7\0" * (i % 4) + bytes([i % 2]) for i, row in enumerate(xyz)
    )
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    vertex = f"element vertex 60\n{axes}property list uchar short seen\nproperty uchar flag\n"
    face = "element face 2\nproperty list uchar int vertex_indices\n"
    faces = struct.pack(">B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 3)
    padded = "".join(f"{x} 0 0 {y} {z}\n" for x, y, z in rows[:50]) + "1.#QNAN 0 0 -1.#IND nan(ind)\n" * 10
    normals = xyz / np.linalg.norm(xyz, axis=1, keepdims=True)
    return {
        "lists.ply": f"ply\nformat ascii 1.0\n{vertex}end_header\n{lists}".encode(),
        "lists_binary.ply": f"ply\nformat binary_little_endian 1.0\n{vertex}end_header\n".encode() + packed + bytes(64),
        "faces.ply": f"ply\nformat binary_big_endian 1.0\n{face}element vertex 60\n{axes}end_header\n".encode()
        + faces
        + xyz.astype(">f4").tobytes(),
        "padded.pcd": "VERSION 0.7\nFIELDS X none _ Y Z\nSIZE 4 4 1 4 4\nTYPE F F U F F\nCOUNT 1 0 2 1 1\nWIDTH 60\n"
        f"HEIGHT 1\nPOINTS 60\nDATA ascii\n{padded}".encode(),
        "names.pts": f"// by hand\n60\n//X Y Z\n# {body[:20]}\n{body}".encode(),
        "units.txt": f"% X [m]\tY [m]\tZ [m]\n{body}".replace(" ", " \t").encode(),
        "cells.csv": ("x,y,z,note\n" + "".join(f"{','.join(row)},\n,{row[0]},,\n" for row in rows)).encode(),
        "index.xyz": "".join(f"{i} {' '.join(row)}\n" for i, row in enumerate(rows)).encode(),
        "normals.xyz": "".join(
            f"{' '.join(row)} {r} {g} {b} {u:.4f} {v:.4f} {w:.4f}\n"
            for row, (r, g, b), (u, v, w) in zip(rows, color, normals, strict=True)
        ).encode(),
    }


def _e57(path: Path, xyz: np.ndarray, color: np.ndarray, **pose: np.ndarray) -> Path:
    import pye57

    with pye57.E57(str(path), mode="w") as file:
        data = {f"cartesian{axis}": column for axis, column in zip("XYZ", xyz.T, strict=True)}
        data |= {f"color{n}": c for n, c in zip(("Red", "Green", "Blue"), color.T, strict=True)}
        file.write_scan_raw(data, **pose)
    return path


def _real_files() -> dict[str, Path]:
    """Files of other programs, where they are at hand: an octree-ordered LAZ, extra bytes, full waveforms."""
    folder = Path(os.environ.get("CABLEJAX_DATA", "")) / "parsers" / "laspy" / "tests" / "data"
    copc = "simple.copc.laz"
    names = {"copc.laz": copc, "region.copc.laz": copc, "extra.las": "extrabytes.las", "wave.laz": "fullwave.laz"}
    return {name: folder / file for name, file in names.items() if (folder / file).is_file()}
