"""A coarse start where nothing is known of the pose: features matched, motions through triples of matches, the best kept."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Num
from scipy.spatial import KDTree

from cablejax.geometry.normals import nearest, plain_tree, surface_normals
from cablejax.geometry.voxels import voxel_means
from cablejax.registration.correspondences import Oriented
from cablejax.registration.features import point_features

TRIPLES = 200_000
EVEN = 0.9  # least ratio of the lengths of a triple's sides in both clouds
SHORTEST = 8.0  # voxels, of a triple's sides: short ones turn by a lot for a small error
HYPOTHESES = 2_000
FINALISTS = 40
NEAR = 1.5  # voxels within which a point is taken to lie on the other cloud


class CoarseStart(NamedTuple):
    """A motion to begin with `[4, 4]`, and the share of the source that then lies on the target."""

    T_target_source: Float[np.ndarray, "4 4"]
    overlap: float


def coarse_start(
    source: Num[np.ndarray, "n 3"], target: Num[np.ndarray, "m 3"], *, voxel: float | int, seed: int = 0
) -> CoarseStart:
    """A motion near the true one, whatever the pose, for `register` to begin with.

    Both clouds are thinned; each point is described by its surroundings (`point_features`) and matched with the target
    point most like it. Triples of matches whose sides agree in length give motions (RANSAC), counted by the matches that
    follow them and at last by the points that come to lie on the target.

    What a surface does not show is not found: of the poses about and along a bare cable it gives any.

    Args:
        source: Points `[n, 3]`.
        target: Points `[m, 3]`, in the same unit.
        voxel: Side of the voxels both are thinned to: a few thousand points should be left.
        seed: Of the triples drawn.

    Raises:
        ValueError: If fewer than 30 voxels hold points, or no triple of matches agrees.
    """
    clouds = []
    for xyz, name in ((source, "source"), (target, "target")):
        xyz = np.asarray(xyz, dtype=np.float64)
        thin = voxel_means(xyz[np.isfinite(xyz).all(axis=1)], voxel)
        if len(thin) < 30:
            raise ValueError(f"{name}: expected at least 30 voxels of {voxel:g} with points, got {len(thin)}")
        tree = plain_tree(thin)
        clouds.append((Oriented(thin, surface_normals(thin, k=20, tree=tree)), tree))
    (moving, _), (fixed, fixed_tree) = clouds
    own, other = (point_features(cloud, tree, k=60) for cloud, tree in clouds)
    pairs = _matches(own, other)
    motions = _motions(moving.xyz[pairs[0]], fixed.xyz[pairs[1]], voxel, np.random.default_rng(seed))
    return _best(motions, moving, fixed, fixed_tree, NEAR * voxel)


def _matches(own: np.ndarray, other: np.ndarray) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Rows of both clouds whose features are nearest each other, the nearest for either side."""
    there = np.asarray(KDTree(other).query(own, workers=-1)[1])
    back = np.asarray(KDTree(own).query(other, workers=-1)[1])
    first = np.concatenate([np.arange(len(own)), back])
    second = np.concatenate([there, np.arange(len(other))])
    both = np.unique(np.stack([first, second], axis=1), axis=0)
    mutual = both[(there[both[:, 0]] == both[:, 1]) & (back[both[:, 1]] == both[:, 0])]
    chosen = mutual if len(mutual) >= 200 else both
    return chosen[:, 0], chosen[:, 1]


def _motions(p: np.ndarray, q: np.ndarray, voxel: float, rng: np.random.Generator) -> Float[np.ndarray, "h 4 4"]:
    """Motions through triples of matches `p` to `q` whose sides agree, the `FINALISTS` that most matches follow.

    Raises:
        ValueError: If there are none.
    """
    rows = rng.integers(len(p), size=(TRIPLES, 3))
    sides = [(np.linalg.norm(x[rows] - x[np.roll(rows, 1, axis=1)], axis=2)) for x in (p, q)]
    shorter, longer = np.minimum(*sides), np.maximum(*sides)
    good = ((shorter > EVEN * longer) & (shorter > SHORTEST * voxel)).all(axis=1)
    rows = rows[good][:HYPOTHESES]
    if len(rows) == 0:
        raise ValueError(
            "source, target: no three matches agree; the scans share too little, or the voxel is too large"
        )
    motions = _kabsch(p[rows], q[rows])
    sample = rng.permutation(len(p))[:2000]
    follow = np.empty(len(motions))
    for i, T in enumerate(motions):
        apart = p[sample] @ T[:3, :3].T + T[:3, 3] - q[sample]
        follow[i] = (np.einsum("ij,ij->i", apart, apart) < (NEAR * voxel) ** 2).sum()
    return motions[np.argsort(-follow, kind="stable")[:FINALISTS]]


def _kabsch(p: Float[np.ndarray, "h k 3"], q: Float[np.ndarray, "h k 3"]) -> Float[np.ndarray, "h 4 4"]:
    """The best motion of each set of points, eq. (9) as `cablejax.ops.kabsch`, for many sets in float64."""
    mean_p, mean_q = p.mean(axis=1), q.mean(axis=1)
    u, _, vt = np.linalg.svd((q - mean_q[:, None]).transpose(0, 2, 1) @ (p - mean_p[:, None]))
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    out = np.tile(np.eye(4), (len(p), 1, 1))
    out[:, :3, :3] = u @ vt
    out[:, :3, 3] = mean_q - np.einsum("hij,hj->hi", out[:, :3, :3], mean_p)
    return out


def _best(motions: np.ndarray, moving: Oriented, fixed: Oriented, tree: KDTree, max_distance: float) -> CoarseStart:
    """The motion that brings most of the source onto the target, with normals alike, after some plain steps of ICP."""
    sample = slice(None, None, max(1, len(moving.xyz) // 2000))
    best = CoarseStart(motions[0], -1.0)
    for T in motions:
        for _ in range(5):
            xyz = moving.xyz[sample] @ T[:3, :3].T + T[:3, 3]
            distance, near = (found[:, 0] for found in nearest(tree, xyz, k=1, max_distance=2 * max_distance))
            rows = np.isfinite(distance)
            if rows.sum() < 6:
                break
            T = _kabsch(xyz[rows][None], fixed.xyz[near[rows]][None])[0] @ T
        xyz, normals = moving.xyz[sample] @ T[:3, :3].T + T[:3, 3], moving.normals[sample] @ T[:3, :3].T
        distance, near = (found[:, 0] for found in nearest(tree, xyz, k=1, max_distance=max_distance))
        there = fixed.normals[np.minimum(near, len(fixed.xyz) - 1)]
        on = np.isfinite(distance) & (np.abs(np.sum(there * normals, axis=1)) > 0.8)
        if on.mean() > best.overlap:
            best = CoarseStart(T, float(on.mean()))
    return best
