"""Partners from a k-d tree on the host, asked again only for the points that have moved too far since.

A point that moved by d since the tree was asked has its nearest neighbour among the k found then as long as the nearest of
them is within (distance to the k-th) - d. Close to the solution hardly any point is asked for a second time.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from cablejax.registration.loop import Carried
from cablejax.registration.normals import normals_of, plain_tree

CARRIED = 4  # nearest target points that each source point carries along
FURTHER = 1.5  # reaches within which the tree looks: what lies beyond is not soon a partner
FAR = 1e9  # stands for no point; its square is finite in float32
LEAST_SIZE = 512


class Surface:
    """A cloud with its tree, normals and spacing.

    Attributes:
        xyz: Points `[m, 3]`.
        normals: Unit normals of either sign `[m, 3]`.
        tree: Over the points.
        spacing: Median distance to the nearest other point.
    """

    def __init__(self, xyz: Float[np.ndarray, "m 3"], *, k: int) -> None:
        self.xyz = xyz
        self.tree: KDTree = plain_tree(xyz)
        distance, near = self.tree.query(xyz, k=range(1, max(2, min(k, len(xyz))) + 1), workers=-1)
        self.normals = normals_of(xyz, near)
        self.spacing = float(np.median(distance[:, 1]))
        self._table = np.concatenate([xyz, self.normals], axis=1).astype(np.float32)

    def rows(self, near: Int[np.ndarray, "n k"]) -> Float[np.ndarray, "n k 6"]:
        """Points and normals side by side; a point that is nowhere for the row m."""
        return np.concatenate([self._table, np.array([[FAR, FAR, FAR, 0, 0, 0]], np.float32)])[near]


def padded_size(n: int) -> int:
    """The next of 512, 768, 1024, 1536, ...: few sizes, so that other clouds seldom compile anew."""
    size = LEAST_SIZE
    while size < n:
        if size * 3 // 2 >= n:
            return size * 3 // 2
        size *= 2
    return size


class Partners:
    """What the source points carry along, and the tree to ask again."""

    def __init__(self, source: np.ndarray, source_normals: np.ndarray | None, target: Surface, *, reach: float) -> None:
        n, self._target, self._source = len(source), target, source
        self._reach = reach
        size = padded_size(n)
        both = np.zeros((6, size), np.float32)
        both[:3, :n] = source.T
        if source_normals is not None:
            both[3:, :n] = source_normals.T
        self._fixed = jnp.asarray(both[:3]), jnp.asarray(both[3:])
        self._valid = jnp.asarray(np.arange(size) < n)
        self._near = np.full((CARRIED, 6, size), FAR, np.float32)
        self._asked = np.zeros((3, size), np.float32)
        self._bound = np.full(size, np.inf, np.float32)

    def ask(self, T: Float[np.ndarray, "4 4"], which: Bool[np.ndarray, " n"] | None) -> Carried:
        """Ask the tree for the points of `which`, or all of them, at a motion."""
        rows = slice(0, len(self._source)) if which is None else np.flatnonzero(which)
        moved = self._source[rows] @ T[:3, :3].T + T[:3, 3]
        far = FURTHER * self._reach
        distance, near = self._target.tree.query(
            moved, k=range(1, CARRIED + 1), distance_upper_bound=far, workers=-1 if len(moved) > 2000 else 1
        )
        self._near[:, :, rows] = self._target.rows(near).transpose(1, 2, 0)
        self._asked[:, rows] = moved.T
        whole = len(self._target.xyz) <= CARRIED
        self._bound[rows] = np.inf if whole else np.minimum(distance[:, -1], far) * (1 - 1e-6)
        return jax.device_put(
            Carried(*self._fixed, self._near[:, :3], self._near[:, 3:], self._asked, self._bound, self._valid)
        )
