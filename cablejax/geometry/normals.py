"""Normals of a cloud, on the host."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.spatial import KDTree

BLOCK = 1024  # points whose neighbourhoods are summed at once: they stay in the cache, four times as fast
LINE = 1e-3  # squared length of the longest product of rows below which the closed form loses the direction


def surface_normals(
    xyz: Float[np.ndarray, "n 3"], *, k: int = 20, tree: KDTree | None = None
) -> Float[np.ndarray, "n 3"]:
    """Unit normals `[n, 3]`, of either sign: the direction in which the `k` nearest points (itself among them) vary least.

    Example:
        >>> flat = np.random.default_rng(0).uniform(size=(50, 3)) * [1, 1, 0]
        >>> bool(np.allclose(np.abs(surface_normals(flat, k=8)), [0, 0, 1]))
        True
    """
    return least_direction(covariances_nearest(xyz, plain_tree(xyz) if tree is None else tree, k=k))


def plain_tree(xyz: Float[np.ndarray, "n 3"]) -> KDTree:
    """A tree that is split in the middle of its boxes: built in half the time, asked as fast."""
    return KDTree(xyz, leafsize=24, balanced_tree=False, compact_nodes=False)


def nearest(
    tree: KDTree, xyz: Float[np.ndarray, "n 3"], *, k: int, max_distance: float = np.inf
) -> tuple[Float[np.ndarray, "n k"], Int[np.ndarray, "n k"]]:
    """Distances and rows of the `k` nearest points; inf and the number of points where there are fewer within `max_distance`."""
    # Threads cost more than they bring for few questions.
    distance, near = tree.query(xyz, k=k, distance_upper_bound=max_distance, workers=-1 if len(xyz) > 2000 else 1)
    return np.asarray(distance).reshape(-1, k), np.asarray(near).reshape(-1, k)


def covariances(
    xyz: Float[np.ndarray, "n 3"], near: Int[np.ndarray, "m k"], *, at: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 6"]:
    """Covariance of the `k` points in each row of `near`, taken about a place `at` near them: xx, yy, zz, xy, xz, yz."""
    columns = [np.ascontiguousarray(column) for column in xyz.T]
    out = np.empty((len(near), 6))
    for first in range(0, len(near), BLOCK):
        part = slice(first, first + BLOCK)
        rows = near[part].T  # sums over the neighbours are then sums of long rows
        around = [column.take(rows) - place for column, place in zip(columns, at[part].T, strict=True)]
        x, y, z = (values - values.mean(axis=0) for values in around)
        for entry, (a, b) in enumerate(((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))):
            out[part, entry] = np.einsum("kn,kn->n", a, b) / len(rows)
    return out


def covariances_nearest(
    xyz: Float[np.ndarray, "n 3"], tree: KDTree, *, k: int, at: Float[np.ndarray, "m 3"] | None = None
) -> Float[np.ndarray, "m 6"]:
    """Covariance of the `k` points nearest to each point, or to each of `at`, as in `covariances`."""
    at = xyz if at is None else at
    return covariances(xyz, nearest(tree, at, k=min(k, len(xyz)))[1], at=at)


def covariances_within(
    xyz: Float[np.ndarray, "n 3"], tree: KDTree, *, radius: float, least: int, k: int
) -> Float[np.ndarray, "n 6"]:
    """Covariance of the points within `radius` of each point, as in `covariances`; of the `k` nearest where that holds fewer
    than `least`.

    All pairs at once come out of the tree up to three times as fast as neighbours point by point, most so on dense surfaces.
    """
    n, pairs = len(xyz), tree.query_pairs(radius, output_type="ndarray")
    x, y, z = (xyz - xyz.mean(axis=0)).T
    own = np.stack([np.ones(n), x, y, z, *_products(x, y, z)], axis=1)
    other = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n)).tocsr()
    total = own + other @ own + other.T @ own
    count = total[:, 0]
    mean = total[:, 1:] / count[:, None]
    out = mean[:, 3:] - np.stack(_products(*mean[:, :3].T), axis=1)
    lonely = count < least
    if lonely.any():
        out[lonely] = covariances_nearest(xyz, tree, k=k, at=xyz[lonely])
    return out


def _products(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
    """xx, yy, zz, xy, xz, yz."""
    return [x * x, y * y, z * z, x * y, x * z, y * z]


def least_direction(covariance: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 3"]:
    """Eigenvectors `[n, 3]` of the smallest eigenvalues of symmetric matrices, given by xx, yy, zz, xy, xz, yz.

    The smallest root of the cubic in closed form (Smith 1961), then the longest cross product of two rows of C - root I.
    Where the two smallest eigenvalues are nearly equal that product vanishes, and LAPACK is asked.
    """
    third = covariance[:, :3].mean(axis=1)
    a, b, c = covariance[:, :3].T - third
    d, e, f = covariance[:, 3:].T
    size = np.sqrt((a * a + b * b + c * c + 2 * (d * d + e * e + f * f)) / 6)
    safe = np.where(size > 0, size, 1.0)
    a, b, c, d, e, f = (entry / safe for entry in (a, b, c, d, e, f))
    half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    root = 2 * np.cos(np.arccos(np.clip(half, -1, 1)) / 3 + 2 * np.pi / 3)
    a, b, c = a - root, b - root, c - root
    products = np.stack(
        [
            np.stack([d * f - e * b, e * d - a * f, a * b - d * d]),
            np.stack([d * c - e * f, e * e - a * c, a * f - d * e]),
            np.stack([b * c - f * f, f * e - d * c, d * f - b * e]),
        ]
    )
    length = np.einsum("pin,pin->pn", products, products)
    best, columns = np.argmax(length, axis=0), np.arange(len(covariance))
    longest = length[best, columns]
    out = products[best, :, columns] / np.sqrt(np.where(longest > 0, longest, 1.0))[:, None]
    unsure = np.flatnonzero(longest < LINE)
    if len(unsure):
        out[unsure] = fitted_planes(covariance[unsure])[0]
    return out


def fitted_planes(covariance: Float[np.ndarray, "n 6"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Normals `[n, 3]` of the planes through neighbourhoods of given covariance, and the standard deviation from them `[n]`.

    By LAPACK, with which small deviations keep their digits.
    """
    xx, yy, zz, xy, xz, yz = covariance.T
    full = np.stack([np.stack([xx, xy, xz]), np.stack([xy, yy, yz]), np.stack([xz, yz, zz])])
    values, vectors = np.linalg.eigh(full.transpose(2, 0, 1))
    return vectors[:, :, 0], np.sqrt(np.maximum(values[:, 0], 0.0))
