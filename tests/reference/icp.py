"""Iterative closest points as in the textbook, in float64: SciPy's tree, normal equations written out."""

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation


def plane_icp(source: np.ndarray, target: np.ndarray, normals: np.ndarray, *, reach: float, steps: int) -> np.ndarray:
    """Point to plane, every direction free; returns the motion `[4, 4]`."""
    T, tree = np.eye(4), KDTree(target)
    for _ in range(steps):
        moved = source @ T[:3, :3].T + T[:3, 3]
        distance, near = tree.query(moved)
        p, q, n = moved[distance < reach], target[near[distance < reach]], normals[near[distance < reach]]
        rows = np.concatenate([np.cross(p, n), n], axis=1)
        twist = np.linalg.lstsq(rows, np.sum(n * (q - p), axis=1), rcond=None)[0]
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(twist[:3]).as_matrix()
        step[:3, 3] = twist[3:]
        T = step @ T
    return T
