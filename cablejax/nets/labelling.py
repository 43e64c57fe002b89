"""Labels for every point of a scan, by a network that sees a ball of it at a time."""

from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float, Int, Num
from scipy.spatial import KDTree

MOST_POINTS = 60_000  # labelled by the network; of more, the rest takes the label of its nearest
INNER = 0.7  # of the ball's radius: points farther out have seen half of their surroundings
RIM_WEIGHT = (
    0.02  # say of a point on the rim of a ball, beside 1 + this in its middle: never 0, for it may be the only one
)
BATCH = 16


class PartLabels(NamedTuple):
    """What a network says of each point.

    Attributes:
        part: Likeliest class of each point `[n]`; -1 for rows that are no points (NaN).
        probability: Of each class `[n, P]`, the mean over the balls that held the point; NaN likewise.
    """

    part: Int[np.ndarray, " n"]
    probability: Float[np.ndarray, "n parts"]


def label_parts(
    model: nnx.Module, xyz_mm: Num[np.ndarray, "n 3"], *, n_points: int = 1024, ball_mm: float = 250.0, seed: int = 0
) -> PartLabels:
    """Label the points of a scan.

    Balls are laid over the scan until each point lies well within one of them; each ball is dealt out into clouds of
    `n_points`, as the network was trained on. Points near the rim of a ball have less say in what is said of them.

    Args:
        model: Called as `(xyz [b, n, 3], mask [b, n]) -> logits [b, n, P]`, in evaluation mode.
        xyz_mm: The scan `[n, 3]`, mm; rows with NaN are passed over.
        n_points: Points that the network sees at a time.
        ball_mm: Radius of the balls.
        seed: Of the order in which points are taken.

    Raises:
        ValueError: If the scan is not `[n, 3]` or holds no point.
    """
    xyz_mm = np.asarray(xyz_mm, dtype=np.float64)
    if xyz_mm.ndim != 2 or xyz_mm.shape[1] != 3:
        raise ValueError(f"xyz_mm: expected shape [n, 3], got {list(xyz_mm.shape)}")
    valid = np.flatnonzero(np.isfinite(xyz_mm).all(axis=1))
    if len(valid) == 0:
        raise ValueError("xyz_mm: expected at least one point, got none")
    rng = np.random.default_rng(seed)
    taken = valid if len(valid) <= MOST_POINTS else np.sort(rng.choice(valid, MOST_POINTS, replace=False))
    found = _labelled(model, xyz_mm[taken], n_points, ball_mm, rng)
    if len(taken) < len(valid):
        found = found[KDTree(xyz_mm[taken]).query(xyz_mm[valid], workers=-1)[1]]
    probability = np.full((len(xyz_mm), found.shape[1]), np.nan)
    part = np.full(len(xyz_mm), -1)
    probability[valid], part[valid] = found, found.argmax(axis=1)
    return PartLabels(part, probability)


def _labelled(
    model: nnx.Module, xyz: np.ndarray, n_points: int, ball_mm: float, rng: np.random.Generator
) -> Float[np.ndarray, "n parts"]:
    """Probabilities of every point, ball after ball, `BATCH` clouds a call."""
    clouds, centers = [], []
    for center, rows in _balls(xyz, ball_mm, rng):
        for start in range(0, len(rows), n_points):
            clouds.append(rows[start : start + n_points] if start + n_points <= len(rows) else rows[-n_points:])
            centers.append(center)
    graphdef, state = nnx.split(model)
    total = None
    for first in range(0, len(clouds), BATCH):
        batch = clouds[first : first + BATCH]
        points, mask = np.zeros((BATCH, n_points, 3), np.float32), np.zeros((BATCH, n_points), bool)
        for i, rows in enumerate(batch):
            points[i, : len(rows)], mask[i, : len(rows)] = xyz[rows] - xyz[rows].mean(axis=0), True
        out = np.asarray(_probabilities(graphdef, state, points, mask), np.float64)
        total = np.zeros((len(xyz), out.shape[-1])) if total is None else total
        for rows, center, seen in zip(batch, centers[first:], out, strict=False):
            away = np.sum((xyz[rows] - center) ** 2, axis=1) / ball_mm**2
            total[rows] += (1 + RIM_WEIGHT - away)[:, None] * seen[: len(rows)]
    assert total is not None
    return total / total.sum(axis=1, keepdims=True)


@partial(jax.jit, static_argnames=("graphdef",))
def _probabilities(
    graphdef: Any, state: Any, points: Float[Array, "b n 3"], mask: Bool[Array, "b n"]
) -> Float[Array, "b n parts"]:
    """What the network says of each point: one program for all scans that a process labels."""
    return jax.nn.softmax(nnx.merge(graphdef, state, copy=True)(points, mask))


def _balls(xyz: np.ndarray, ball_mm: float, rng: np.random.Generator):
    """Centres with the rows about them in random order, until every point lies within `INNER` radii of a centre."""
    tree = KDTree(xyz)
    left = np.ones(len(xyz), dtype=bool)
    for row in rng.permutation(len(xyz)):
        if left[row]:
            near = np.array(tree.query_ball_point(xyz[row], ball_mm))
            left[near[np.sum((xyz[near] - xyz[row]) ** 2, axis=1) <= (INNER * ball_mm) ** 2]] = False
            yield xyz[row], rng.permutation(near)
