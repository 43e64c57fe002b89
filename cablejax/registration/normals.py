"""Normals of a cloud, on the host."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree


def surface_normals(
    xyz: Float[np.ndarray, "n 3"], *, k: int = 20, tree: KDTree | None = None
) -> Float[np.ndarray, "n 3"]:
    """Unit normals `[n, 3]`, of either sign: the direction in which the `k` nearest points (itself among them) vary least.

    Example:
        >>> flat = np.random.default_rng(0).uniform(size=(50, 3)) * [1, 1, 0]
        >>> bool(np.allclose(np.abs(surface_normals(flat, k=8)), [0, 0, 1]))
        True
    """
    k = min(k, len(xyz))
    _, near = (KDTree(xyz) if tree is None else tree).query(xyz, k=k, workers=-1)
    spread = xyz[near] - xyz[near].mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]
