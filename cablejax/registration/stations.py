"""Several scans of one scene brought into one frame: every pair that shares enough is registered, then all at once."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Num

from cablejax.registration.coarse import coarse_start
from cablejax.registration.gauss_newton import Kernel, Method
from cablejax.registration.graph import edge_of, solve_graph, spanning
from cablejax.registration.pyramid import register
from cablejax.registration.result import RegistrationResult

LEAST_OVERLAP = 0.2  # share of the thinned source with a corresponding point, below which a pair says too little
ROUNDS = 2  # pairs are registered again from where the graph puts them


class Stations(NamedTuple):
    """Poses of stations.

    Attributes:
        T_world_station: Pose of each station `[s, 4, 4]`; the world is the first station's frame.
        pairs: The registrations that were used, by (source, target).
        rmse: Root mean square distance between corresponding points, over all pairs, in the clouds' unit.
    """

    T_world_station: Float[np.ndarray, "s 4 4"]
    pairs: dict[tuple[int, int], RegistrationResult]
    rmse: float


def register_stations(
    clouds: Sequence[Num[np.ndarray, "_ 3"]],
    *,
    voxels: Sequence[float | int],
    T_world_station: Float[np.ndarray, "s 4 4"] | None = None,
    start: str = "given",
    max_distance_voxels: float | int = 2.0,
    method: Method = "gicp",
    kernel: Kernel = "none",
) -> Stations:
    """Bring several scans into the frame of the first.

    Every pair is registered from coarse to fine; those that share a fifth or more make a pose graph, in which each counts
    by its covariance, and not at all along what it did not see. Then once more from the poses found.

    Args:
        clouds: Points `[n, 3]` of each station, in its own frame; two or more, in the same unit.
        voxels: Sides of the voxels, coarse to fine, as in `register`.
        T_world_station: Poses to begin with `[s, 4, 4]`; the identity for all if None.
        start: "given" for these poses, "features" to find coarse ones by `coarse_start` at the coarsest voxel.
        max_distance_voxels: Maximum distance between corresponding points, in voxels. Stations see different parts of a
            cable: a large one pairs the rim of one part with what lies next to it in the other.
        method, kernel: As in `register`.

    Raises:
        ValueError: If there are fewer than two clouds, or some share too little with the others, naming them.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> box = rng.uniform(size=(3, 3000, 3)); box[:, np.arange(3000), np.arange(3000) % 3] = 0
        >>> found = register_stations([box[0], box[1] - [0.02, 0, 0], box[2] + [0, 0.01, 0]], voxels=[0.1, 0.05])
        >>> np.abs(found.T_world_station[:, :3, 3] - [[0, 0, 0], [0.02, 0, 0], [0, -0.01, 0]]).max() < 2e-3
        np.True_
    """
    count = len(clouds)
    if count < 2:
        raise ValueError(f"clouds: expected two or more, got {count}")
    if start not in ("given", "features"):
        raise ValueError(f"start: expected one of given, features, got {start!r}")
    poses = np.tile(np.eye(4), (count, 1, 1)) if T_world_station is None else np.asarray(T_world_station, dtype=float)
    if poses.shape != (count, 4, 4):
        raise ValueError(f"T_world_station: expected shape [{count}, 4, 4], got {list(poses.shape)}")
    pairs: dict[tuple[int, int], RegistrationResult] = {}
    for number in range(ROUNDS):
        pairs = {}
        for target, source in combinations(range(count), 2):
            if number == 0 and start == "features":
                try:
                    begin = coarse_start(clouds[source], clouds[target], voxel=voxels[0]).T_target_source
                except ValueError:  # this pair has nothing in common; others may join both
                    continue
            else:
                begin = np.linalg.inv(poses[target]) @ poses[source]
            found = register(
                clouds[source], clouds[target], voxels=voxels if number == 0 else voxels[-1:],
                max_distance_voxels=max_distance_voxels, T_init=begin, method=method, kernel=kernel,
            )  # fmt: skip
            if found.overlap >= LEAST_OVERLAP:
                pairs[source, target] = found
        edges = [edge_of(source, target, found) for (source, target), found in pairs.items()]
        poses = solve_graph(spanning(count, edges, [found.overlap for found in pairs.values()]), edges)
    weight = np.array([found.inliers for found in pairs.values()])
    square = np.array([found.rmse**2 for found in pairs.values()])
    return Stations(poses, pairs, float(np.sqrt(weight @ square / weight.sum())))
