"""Normals of a cloud, on the host."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

LINE = 1e-3  # second-largest variance over the largest below which the closed form loses the normal's direction


def surface_normals(
    xyz: Float[np.ndarray, "n 3"], *, k: int = 20, tree: KDTree | None = None
) -> Float[np.ndarray, "n 3"]:
    """Unit normals `[n, 3]`, of either sign: the direction in which the `k` nearest points (itself among them) vary least.

    Example:
        >>> flat = np.random.default_rng(0).uniform(size=(50, 3)) * [1, 1, 0]
        >>> bool(np.allclose(np.abs(surface_normals(flat, k=8)), [0, 0, 1]))
        True
    """
    _, near = (plain_tree(xyz) if tree is None else tree).query(xyz, k=range(1, min(k, len(xyz)) + 1), workers=-1)
    return normals_of(xyz, near)


def plain_tree(xyz: Float[np.ndarray, "n 3"]) -> KDTree:
    """A tree that is split in the middle of its boxes: built in half the time, asked as fast."""
    return KDTree(xyz, leafsize=24, balanced_tree=False, compact_nodes=False)


def normals_of(xyz: Float[np.ndarray, "n 3"], near: Int[np.ndarray, "n k"]) -> Float[np.ndarray, "n 3"]:
    """The direction of least variance of the points `near` each point; any one where all lie on a line."""
    x, y, z = (values[near] for values in (np.ascontiguousarray(column) for column in xyz.T))
    x, y, z = (values - values.mean(axis=1, keepdims=True) for values in (x, y, z))
    pairs = ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))
    return least_direction(*(np.einsum("nk,nk->n", a, b) for a, b in pairs))


def least_direction(
    xx: np.ndarray, yy: np.ndarray, zz: np.ndarray, xy: np.ndarray, xz: np.ndarray, yz: np.ndarray
) -> Float[np.ndarray, "n 3"]:
    """Eigenvectors `[n, 3]` of the smallest eigenvalues of symmetric matrices, given by their entries `[n]`.

    Trigonometric solution of the cubic (Smith 1961), then the longest cross product of two rows of C - value I. Where
    the two smallest eigenvalues are both near zero that product vanishes, and LAPACK is asked.
    """
    third = (xx + yy + zz) / 3
    spread = ((xx - third) ** 2 + (yy - third) ** 2 + (zz - third) ** 2 + 2 * (xy**2 + xz**2 + yz**2)) / 6
    size = np.sqrt(spread)
    safe = np.where(size > 0, size, 1.0)
    a, b, c = (xx - third) / safe, (yy - third) / safe, (zz - third) / safe
    d, e, f = xy / safe, xz / safe, yz / safe
    half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    angle = np.arccos(np.clip(half, -1, 1)) / 3
    low = 2 * np.cos(angle + 2 * np.pi / 3)
    a, b, c = a - low, b - low, c - low
    products = np.stack(
        [
            np.stack([d * f - e * b, e * d - a * f, a * b - d * d]),
            np.stack([d * c - e * f, e * e - a * c, a * f - d * e]),
            np.stack([b * c - f * f, f * e - d * c, d * f - b * e]),
        ]
    )
    length = np.einsum("pin,pin->pn", products, products)
    best = np.argmax(length, axis=0)
    columns = np.arange(len(xx))
    longest = length[best, columns]
    out = (products[best, :, columns] / np.sqrt(np.where(longest > 0, longest, 1.0))[:, None]).copy()
    unsure = np.flatnonzero(longest < LINE)
    if len(unsure):
        full = np.stack([np.stack([xx, xy, xz]), np.stack([xy, yy, yz]), np.stack([xz, yz, zz])])[:, :, unsure]
        out[unsure] = np.linalg.eigh(full.transpose(2, 0, 1))[1][:, :, 0]
    return out
