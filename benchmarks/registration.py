"""Registration beside Open3D, and small_gicp where it is installed, on the same clouds in one run.

    CABLEJAX_DATA=... python -m benchmarks.registration --write

Two sources of clouds: the LiDAR pair of small_gicp (MIT) from the identity, whole and thinned at random to 10,000 points;
and two stations of a simulated cable with two bends, 10,000 to 1,000,000 points each, from 2.5 mm and 1 degree off. Such
a cable shows 0.3 % of a motion along its length; `least_share` is set to 0.1 %, so that ours moves along it as the others
do, and the error is the one across the cable. All contenders thin to the same voxels, level by level, and pair within the
same maximum distance; normals come from 20 neighbours (ours from those within 2.5 voxels where there are enough), and of
the target alone for point-to-plane. Rounds take turns and draw other points. The first call of
a size and the first one on other clouds of about that size are given apart, since compilation is in them.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import record
from cablejax.io import import_open3d, read_points
from cablejax.registration import register

RESULT = Path("results/benchmarks/registration.json")
METHODS = ("plane", "gicp")
REST_S = 0.05  # before each run, in which the threads of the library before come to rest


class Task(NamedTuple):
    """Two clouds `[n, 3]`, the true motion, where to begin, voxels coarse to fine, maximum distance in voxels, the unit in
    mm, and the point and the axes (of the source) at which the error counts."""

    source: np.ndarray
    target: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    voxels: tuple[float, ...]
    max_distance_voxels: float
    unit_mm: float
    at: np.ndarray
    axes: tuple[int, ...]
    least_share: float


Contender = Callable[[Task, str], np.ndarray]


def lidar(folder: Path, n: int | None) -> Callable[[int], Task]:
    """The pair of small_gicp in metres, `n` points of each drawn by a seed; returns at the origin are misses."""
    both = [read_points(folder / name, unit="m").xyz_mm / 1000 for name in ("source.ply", "target.ply")]
    source, target = (cloud[np.abs(cloud).sum(axis=1) > 0] for cloud in both)
    truth = np.loadtxt(folder / "T_target_source.txt")

    def draw(seed: int) -> Task:
        rng = np.random.default_rng(seed)
        clouds = [cloud if n is None else cloud[rng.permutation(len(cloud))[:n]] for cloud in (source, target)]
        return Task(
            clouds[0], clouds[1], truth, np.eye(4), (0.5, 0.25, 0.125), 4.0, 1000.0, np.zeros(3), (0, 1, 2), 1e-2
        )

    return draw


def stations(n: int, voxels: tuple[float, ...]) -> Callable[[int], Task]:
    """Two stations of a simulated cable, each in its own frame, and their true relative pose; nine tenths by a seed."""
    import jax

    from cablejax.simulate import catalogue, simulate_scan, station_points

    scan = simulate_scan(
        catalogue()[8], n_points=round(2.5 * n), shape="s-bend", arc_deg=120.0, stations=2, key=jax.random.key(7)
    )
    source, target = (np.asarray(station_points(scan, i), dtype=np.float64) for i in (1, 0))
    poses = np.asarray(scan.T_cable_station, dtype=np.float64)
    truth = np.linalg.inv(poses[0]) @ poses[1]
    off = np.eye(4)
    off[:3, :3] = Rotation.from_rotvec(np.radians([0.6, -0.6, 0.5])).as_matrix()
    middle = target.mean(axis=0)
    off[:3, 3] = middle - off[:3, :3] @ middle + [0.0, -1.8, 1.7]

    def draw(seed: int) -> Task:
        rng = np.random.default_rng(seed)
        clouds = [cloud[rng.permutation(len(cloud))[:n]] for cloud in (source, target)]
        return Task(clouds[0], clouds[1], truth, off @ truth, voxels, 2.0, 1.0, source.mean(axis=0), (1, 2), 1e-3)

    return draw


def ours(task: Task, method: Any) -> np.ndarray:
    """`cablejax.registration.register`."""
    found = register(
        task.source, task.target, voxels=task.voxels, max_distance_voxels=task.max_distance_voxels, T_init=task.start,
        method=method, least_share=task.least_share,
    )  # fmt: skip
    return found.T_target_source


def open3d_contender() -> Contender:
    """Open3D's ICP at the same levels."""
    o3d = import_open3d()
    pipeline = o3d.pipelines.registration

    def run(task: Task, method: str) -> np.ndarray:
        plane = method == "plane"
        estimation = (
            pipeline.TransformationEstimationPointToPlane()
            if plane
            else pipeline.TransformationEstimationForGeneralizedICP()
        )
        align = pipeline.registration_icp if plane else pipeline.registration_generalized_icp
        full = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz)) for xyz in (task.source, task.target)]
        T = task.start
        for voxel in task.voxels:
            thin = [cloud.voxel_down_sample(voxel) for cloud in full]
            for cloud in thin[1:] if plane else thin:
                cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
            criteria = pipeline.ICPConvergenceCriteria(max_iteration=60)
            T = align(thin[0], thin[1], task.max_distance_voxels * voxel, T, estimation, criteria).transformation
        return np.asarray(T)

    return run


def small_gicp_contender() -> Contender | None:
    """small_gicp at the same levels, where it is installed."""
    try:
        import small_gicp  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    threads = os.cpu_count() or 1

    def run(task: Task, method: str) -> np.ndarray:
        T = task.start
        for voxel in task.voxels:
            target, tree = small_gicp.preprocess_points(task.target, voxel, num_neighbors=20, num_threads=threads)
            source, _ = small_gicp.preprocess_points(task.source, voxel, num_neighbors=20, num_threads=threads)
            kind = "PLANE_ICP" if method == "plane" else "GICP"
            found = small_gicp.align(
                target, source, tree, T, registration_type=kind, max_correspondence_distance=task.max_distance_voxels * voxel,
                num_threads=threads, max_iterations=60,
            )  # fmt: skip
            T = found.T_target_source
        return np.asarray(T)

    return run


def errors(task: Task, T: np.ndarray) -> tuple[float, float]:
    """Distance from the truth in mm, and angle in mrad."""
    apart = (np.linalg.inv(task.truth) @ T @ np.append(task.at, 1.0))[:3] - task.at
    turned = Rotation.from_matrix(task.truth[:3, :3].T @ T[:3, :3]).as_rotvec()
    return task.unit_mm * float(np.linalg.norm(apart[list(task.axes)])), 1e3 * float(np.linalg.norm(turned))


def timed(run: Contender, task: Task, method: str) -> tuple[float, np.ndarray]:
    """Seconds and the motion found."""
    time.sleep(REST_S)
    start = time.perf_counter()
    T = run(task, method)
    return time.perf_counter() - start, T


def side_by_side(draw: Callable[[int], Task], method: str, contenders: dict[str, Contender], rounds: int) -> list[dict]:
    """A row for every contender: median seconds, ratio to Open3D in the same round, root mean square errors."""
    first = {name: timed(run, draw(1000), method)[0] for name, run in contenders.items()}
    other = {name: timed(run, draw(1001), method)[0] for name, run in contenders.items()}
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    apart: dict[str, list[tuple[float, float]]] = {name: [] for name in contenders}
    for seed in range(rounds):
        task = draw(seed)
        for name, run in contenders.items():
            took, T = timed(run, task, method)
            seconds[name].append(took)
            apart[name].append(errors(task, T))
    theirs = np.array(seconds["Open3D"])
    return [
        {
            "method": method,
            "library": name,
            "seconds": float(np.median(times)),
            "over_open3d": float(np.median(np.array(times) / theirs)),
            "first_call_s": first[name],
            "other_clouds_first_s": other[name],
            **dict(
                zip(("error_mm", "error_mrad"), np.sqrt(np.mean(np.square(apart[name]), axis=0)).tolist(), strict=True)
            ),
        }
        for name, times in seconds.items()
    ]


def cases(data: str | None, least: int, most: int) -> Iterator[tuple[str, int, Callable[[int], Task]]]:
    """Name, points in each cloud and how to draw them."""
    if data is not None:
        folder = Path(data) / "registration" / "small_gicp"
        for name, n, drawn in (("LiDAR pair, thinned", 10_000, 10_000), ("LiDAR pair", 69_000, None)):
            if least <= n <= most:
                yield name, n, lidar(folder, drawn)
    for n, voxels in ((10_000, (12.0, 6.0, 3.0)), (100_000, (4.0, 2.0, 1.0)), (1_000_000, (2.0, 1.0, 0.5))):
        if least <= n <= most:
            yield "cable stations", n, stations(n, voxels)


def main() -> None:
    """Run every case and method, print the table, write it if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("CABLEJAX_DATA"), help="real scans; default: $CABLEJAX_DATA")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--most", type=int, default=1_000_000, help="largest number of points")
    parser.add_argument("--least", type=int, default=0, help="smallest number of points; rows of others are kept")
    parser.add_argument("--write", action="store_true", help=f"write {RESULT}")
    options = parser.parse_args()
    contenders: dict[str, Contender] = {"cablejax": ours, "Open3D": open3d_contender()}
    if (peer := small_gicp_contender()) is not None:
        contenders["small_gicp"] = peer
    rows = []
    for name, n, draw in cases(options.data, options.least, options.most):
        for method in METHODS:
            for row in side_by_side(draw, method, contenders, options.rounds):
                rows.append({"clouds": name, "points": n, **row})
                print(
                    f"{name:20s}{n:>9,d} {method:6s}{row['library']:11s}{1e3 * row['seconds']:9.1f} ms"
                    f"{row['over_open3d']:7.2f} x{row['error_mm']:9.3f} mm{row['error_mrad']:8.3f} mrad"
                    f"{row['first_call_s']:7.2f} s first{row['other_clouds_first_s']:7.2f} s other clouds", flush=True,
                )  # fmt: skip
    if options.write:
        config = {"rounds": options.rounds}
        measured = {(row["clouds"], row["points"]) for row in rows}
        kept = [row for row in record.earlier_rows(RESULT, "rows") if (row["clouds"], row["points"]) not in measured]
        rows = sorted(kept + rows, key=lambda row: (row["clouds"], row["points"]))
        record.write(RESULT, {"rows": record.table(rows, config=config)}, seeds=[7], config=config)


if __name__ == "__main__":
    main()
