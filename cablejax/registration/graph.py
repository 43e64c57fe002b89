"""Poses of many stations from the motions between pairs of them: a pose graph, solved by Gauss-Newton."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from cablejax.registration.result import RegistrationResult

FLOOR = (
    0.05  # of a pair's rmse: standard deviation below which no pair is trusted, for pairs share errors that no fit sees
)
ROUNDS = 30


class Edge(NamedTuple):
    """What one registration says about two stations.

    Attributes:
        source, target: Numbers of the stations.
        T_target_source: The motion between them `[4, 4]`.
        information: Inverse covariance `[6, 6]` of the small twist about `center` that is left of it; zero along what
            was not seen.
        center: `[3]`, in the target's frame.
    """

    source: int
    target: int
    T_target_source: Float[np.ndarray, "4 4"]
    information: Float[np.ndarray, "6 6"]
    center: Float[np.ndarray, "3"]


def edge_of(source: int, target: int, found: RegistrationResult) -> Edge:
    """A registration as an edge: its covariance inverted within the directions that were seen."""
    into = np.linalg.pinv(found.directions)
    own = into @ found.covariance @ into.T  # in displacements along the six directions, all in one unit
    seen = np.flatnonzero(found.seen)
    information = np.zeros((6, 6))
    block = own[np.ix_(seen, seen)] + (FLOOR * found.rmse + 1e-12) ** 2 * np.eye(len(seen))
    information[np.ix_(seen, seen)] = np.linalg.inv(block)
    return Edge(source, target, found.T_target_source, into.T @ information @ into, found.center)


def _cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _about(center: np.ndarray) -> np.ndarray:
    """Takes a twist about the origin to the same motion's twist about `center`."""
    out = np.eye(6)
    out[:3, 3:] = -_cross(center)
    return out


def _adjoint(T: np.ndarray) -> np.ndarray:
    """Takes a twist before a motion to the twist after it that does the same."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T[:3, :3]
    out[:3, 3:] = _cross(T[:3, 3]) @ T[:3, :3]
    return out


def _small_twist(T: np.ndarray) -> np.ndarray:
    """Translation and rotation vector of a motion: its twist, to first order in the rotation."""
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])


def _motion(twist: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3]
    return out


def _residual(edge: Edge, poses: np.ndarray) -> np.ndarray:
    """The twist about the edge's centre by which the poses differ from the registration."""
    between = np.linalg.inv(poses[edge.target]) @ poses[edge.source]
    return _about(edge.center) @ _small_twist(between @ np.linalg.inv(edge.T_target_source))


def spanning(count: int, edges: Sequence[Edge], strength: Sequence[float]) -> Float[np.ndarray, "s 4 4"]:
    """Poses along the strongest edges that join all stations; the first station's frame is the world.

    Raises:
        ValueError: If the edges do not join all stations, naming those left.
    """
    poses, known = np.tile(np.eye(4), (count, 1, 1)), {0}
    order = sorted(range(len(edges)), key=lambda i: -strength[i])
    while len(known) < count:
        for i in order:
            edge = edges[i]
            if (edge.source in known) == (edge.target in known):
                continue
            if edge.target in known:
                poses[edge.source] = poses[edge.target] @ edge.T_target_source
            else:
                poses[edge.target] = poses[edge.source] @ np.linalg.inv(edge.T_target_source)
            known |= {edge.source, edge.target}
            break
        else:
            left = ", ".join(str(i) for i in range(count) if i not in known)
            raise ValueError(f"clouds: number {left} (from 0) could not be joined to the others: too little in common")
    return poses


def solve_graph(poses: Float[np.ndarray, "s 4 4"], edges: Sequence[Edge]) -> Float[np.ndarray, "s 4 4"]:
    """Least squares over all edges: sum of xi' information xi, xi the twist by which the poses differ from an edge.

    Edges that disagree with the others by much count less (Cauchy's weight, its scale the median). The first station
    stays. Directions that no edge has seen keep what they are: of all solutions the nearest is taken.
    """
    poses, n = poses.copy(), len(poses)
    for _ in range(ROUNDS):
        found = [_residual(edge, poses) for edge in edges]
        cost = np.array([r @ edge.information @ r for r, edge in zip(found, edges, strict=True)])
        weights = 1 / (1 + cost / max(9 * float(np.median(cost)), 1e-12))
        matrix, right = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
        for edge, r, weight in zip(edges, found, weights, strict=True):
            to_center, information = _about(edge.center), weight * edge.information
            between = np.linalg.inv(poses[edge.target]) @ poses[edge.source]
            slopes = {edge.target: -to_center, edge.source: to_center @ _adjoint(between)}
            for i, a in slopes.items():
                right[6 * i : 6 * i + 6] -= a.T @ information @ r
                for j, b in slopes.items():
                    matrix[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] += a.T @ information @ b
        # Twists of turned frames about far origins are scaled to order one before small values are taken for none.
        stiff = np.diag(matrix)[6:]
        known = stiff > 1e-12 * max(stiff.max(), 1e-300)
        scale = np.where(known, 1 / np.sqrt(np.where(known, stiff, 1.0)), 0.0)
        step = scale * np.linalg.lstsq(scale[:, None] * matrix[6:, 6:] * scale, scale * right[6:], rcond=1e-10)[0]
        for i in range(1, n):
            poses[i] = poses[i] @ _motion(step[6 * i - 6 : 6 * i])
        if np.abs(step).max() < 1e-10 * (1 + np.abs(poses[:, :3, 3]).max()):
            break
    return poses
