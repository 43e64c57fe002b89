"""Registration beside Open3D on the same clouds, in one run: error against the truth, and time as a ratio.

    CABLEJAX_DATA=... python -m benchmarks.registration --out results/registration.json

The pair is the LiDAR pair of small_gicp (MIT), from the identity. Both thin to the same voxels and use the same reach.
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cablejax.io import import_open3d, provenance, read_points, write_json
from cablejax.registration import register

VOXELS = (0.5, 0.25, 0.125)
REACH = 4.0
ROUNDS = 3


def clouds(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Source, target and the true motion, in metres; returns at the origin are misses."""
    both = [read_points(folder / name, unit="m").xyz_mm / 1000 for name in ("source.ply", "target.ply")]
    source, target = (cloud[np.abs(cloud).sum(axis=1) > 0] for cloud in both)
    return source, target, np.loadtxt(folder / "T_target_source.txt")


def ours(method: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """`cablejax.registration.register` with a method."""
    return lambda source, target: register(source, target, voxels=VOXELS, reach=REACH, method=method).T_target_source


def open3d_runner(method: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Open3D's ICP at the same levels."""
    o3d = import_open3d()
    pipeline = o3d.pipelines.registration
    estimation = {
        "point": pipeline.TransformationEstimationPointToPoint,
        "plane": pipeline.TransformationEstimationPointToPlane,
        "gicp": pipeline.TransformationEstimationForGeneralizedICP,
    }[method]()
    align = pipeline.registration_generalized_icp if method == "gicp" else pipeline.registration_icp

    def run(source: np.ndarray, target: np.ndarray) -> np.ndarray:
        full = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz)) for xyz in (source, target)]
        T = np.eye(4)
        for voxel in VOXELS:
            thin = [cloud.voxel_down_sample(voxel) for cloud in full]
            for cloud in thin:
                cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
            criteria = pipeline.ICPConvergenceCriteria(max_iteration=60)
            T = align(thin[0], thin[1], REACH * voxel, T, estimation, criteria).transformation
        return np.asarray(T)

    return run


def main() -> None:
    """Run every method in turn, several rounds, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("CABLEJAX_DATA"), help="default: $CABLEJAX_DATA")
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    if options.data is None:
        parser.error("--data or $CABLEJAX_DATA must name the folder of real scans")
    source, target, truth = clouds(Path(options.data) / "registration" / "small_gicp")
    methods = ("point", "plane", "gicp")
    runs = {
        (name, method): make(method)
        for method in methods
        for name, make in (("cablejax", ours), ("Open3D", open3d_runner))
    }
    seconds: dict[tuple[str, str], list[float]] = {key: [] for key in runs}
    motions = {key: run(source, target) for key, run in runs.items()}  # warm: compiles
    for _ in range(ROUNDS):
        for key, run in runs.items():
            start = time.perf_counter()
            motions[key] = run(source, target)
            seconds[key].append(time.perf_counter() - start)
    table = []
    for (name, method), T in motions.items():
        error = np.linalg.inv(truth) @ T
        ratio = np.median(np.array(seconds[name, method]) / np.array(seconds["Open3D", method]))
        row = {
            "library": name,
            "method": method,
            "error_mm": 1000 * float(np.linalg.norm(error[:3, 3])),
            "error_rad": float(np.linalg.norm(Rotation.from_matrix(error[:3, :3]).as_rotvec())),
            "time_over_open3d": float(ratio),
        }
        table.append(row)
        print(
            "  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{value:>8}" for key, value in row.items())
        )
    if options.out:
        write_json(options.out, {"table": table, "provenance": provenance(seeds=[], config={"voxels_m": list(VOXELS)})})


if __name__ == "__main__":
    main()
