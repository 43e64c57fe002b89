"""Correspondences from a k-d tree on the host, asked again only for the points that have moved too far since.

A point that moved by d since the tree was asked has its nearest neighbour among the k found then as long as the nearest of
them is within (distance to the k-th) - d. Close to the solution hardly any point is asked for a second time.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from cablejax.geometry.normals import nearest
from cablejax.registration.steps import Carried

CARRIED = 4  # nearest target points that each source point carries along
FURTHER = 1.25  # maximum distances within which the tree looks: what lies beyond is not soon a corresponding point
FAR = 1e9  # stands for no point; its square is finite in float32
LEAST_SIZE = 2048


class Oriented(NamedTuple):
    """Points `[n, 3]` with unit normals of either sign `[n, 3]`."""

    xyz: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]


def spacing_of(tree: KDTree, xyz: Float[np.ndarray, "n 3"]) -> float:
    """Median distance to the nearest other point, of some two thousand."""
    return float(np.median(tree.query(xyz[:: max(1, len(xyz) // 2000)], k=2)[0][:, 1]))


def padded_size(n: int) -> int:
    """The next of 2048, 3072, 4096, 6144, ...: few sizes, so that other clouds seldom compile anew."""
    size = LEAST_SIZE
    while size < n:
        if size * 3 // 2 >= n:
            return size * 3 // 2
        size *= 2
    return size


class Correspondences:
    """What the source points carry along, and the tree to ask again.

    Points are in units of order one about an origin; the tree is in the caller's, which `scale` (origin, length) undoes.
    """

    def __init__(
        self,
        source: Oriented,
        target: Oriented,
        tree: KDTree,
        *,
        max_distance: float,
        scale: tuple[np.ndarray, float],
        capacity: int,
    ) -> None:
        n, self._source, self._tree, self._max_distance = len(source.xyz), source.xyz, tree, max_distance
        self._origin, self._size = scale
        # One more point stands for none: the tree's row m.
        self._points = np.append(target.xyz.T, np.full((3, 1), FAR), axis=1).astype(np.float32)
        self._normals = np.append(target.normals.T, np.zeros((3, 1)), axis=1).astype(np.float32)
        size = padded_size(max(n, capacity))  # halved for coarse levels: their shapes follow from the finest level's
        while size // 2 >= max(n, LEAST_SIZE):
            size //= 2
        both = np.zeros((6, size), np.float32)
        both[:3, :n], both[3:, :n] = source.xyz.T, source.normals.T
        self._fixed = jnp.asarray(both[:3]), jnp.asarray(both[3:])
        self._valid = jnp.asarray(np.arange(size) < n)
        self._near = np.full((CARRIED, 3, size), FAR, np.float32)
        self._near_normal = np.zeros((CARRIED, 3, size), np.float32)
        self._asked = np.zeros((3, size), np.float32)
        self._bound = np.full(size, np.inf, np.float32)

    def ask(self, T: Float[np.ndarray, "4 4"], which: Bool[np.ndarray, " n"] | None) -> Carried:
        """Ask the tree for the points of `which`, or all of them, at a motion."""
        rows = slice(0, len(self._source)) if which is None else np.flatnonzero(which)
        moved = self._source[rows] @ T[:3, :3].T + T[:3, 3]
        far = FURTHER * self._max_distance * self._size
        distance, near = nearest(self._tree, self._origin + self._size * moved, k=CARRIED, max_distance=far)
        near = np.ascontiguousarray(near.T)
        for axis in range(3):  # coordinate by coordinate: reads and writes of long rows
            self._near[:, axis, rows] = self._points[axis][near]
            self._near_normal[:, axis, rows] = self._normals[axis][near]
        self._asked[:, rows] = moved.T
        whole = self._tree.n <= CARRIED
        self._bound[rows] = np.inf if whole else np.minimum(distance[:, -1], far) * ((1 - 1e-6) / self._size)
        # NumPy arrays: a jitted function takes them in a tenth of the time that `jnp.asarray` does. They are overwritten by the
        # next question alone, when the steps of this one are done.
        changing = self._near, self._near_normal, self._asked, self._bound
        return Carried(*self._fixed, *changing, self._valid)  # pyright: ignore
