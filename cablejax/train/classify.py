"""The nominal size of a measured cable by a trained network: its probabilities averaged over samples of the scan."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Float, Num

from cablejax.simulate.pose import canonical_pose, centred

PIECES = 16  # samples of the cable whose probabilities are averaged
PIECE_MM = 150.0  # length of cable that a sample shows; training clouds show 120 to 250


def classify_cable(
    model: nnx.Module,
    xyz_mm: Num[np.ndarray, "n 3"],
    along_mm: Num[np.ndarray, " n"],
    *,
    n_points: int,
    canonical: bool = False,
    pieces: int = PIECES,
    piece_mm: float | int = PIECE_MM,
    seed: int = 0,
) -> Float[np.ndarray, " classes"]:
    """Probability of each class that a network trained on short pieces sees in a whole cable (test-time sampling).

    Args:
        model: Called as `(xyz [b, n, 3], mask [b, n]) -> logits [b, classes]`, in evaluation mode.
        xyz_mm: The cable's points `[n, 3]`, mm: `scan[measured.keep]` of `cablejax.measure.measure_cable`.
        along_mm: Place of each along the axis `[n]`: `measured.along_mm[measured.keep]`.
        n_points: Points of a sample, as many as the clouds had that the network learnt from.
        canonical: Whether those were turned to their own axis (`canonical_pose`).
        pieces: Samples whose probabilities are averaged.
        piece_mm: Length of cable that each shows.
        seed: Of the samples.

    Returns:
        Probabilities, summing to 1.

    Raises:
        ValueError: If there is no point, shapes do not fit, or a number is not positive.
    """
    if xyz_mm.ndim != 2 or xyz_mm.shape[1] != 3 or len(xyz_mm) == 0:
        raise ValueError(f"xyz_mm: expected points [n, 3], got shape {list(xyz_mm.shape)}")
    if along_mm.shape != xyz_mm.shape[:1]:
        raise ValueError(f"along_mm: expected shape [{len(xyz_mm)}], got {list(along_mm.shape)}")
    for name, value in (("n_points", n_points), ("pieces", pieces), ("piece_mm", piece_mm)):
        if not value > 0:
            raise ValueError(f"{name}: expected a number above 0, got {value!r}")
    drawn = _drawn(xyz_mm, along_mm, n_points, pieces, float(piece_mm), np.random.default_rng(seed))
    mask = jnp.ones(drawn.shape[:2], dtype=bool)
    posed = jax.vmap(canonical_pose if canonical else centred)(jnp.asarray(drawn), mask)
    logits = np.asarray(jax.jit(model)(posed, mask))
    return np.asarray(jax.nn.softmax(logits, axis=1)).mean(axis=0)


def _drawn(
    xyz: np.ndarray, along: np.ndarray, n: int, pieces: int, length: float, rng: np.random.Generator
) -> Float[np.ndarray, "pieces n 3"]:
    """Random samples of random stretches, each about its mean; the points nearest a stretch's middle where it holds few."""
    drawn = []
    for _ in range(pieces):
        start = rng.uniform(along.min(), max(along.max() - length, along.min()))
        here = np.flatnonzero((along >= start) & (along <= start + length))
        here = here if len(here) >= n else np.argsort(np.abs(along - start - length / 2))[: max(n, len(here))]
        drawn.append(xyz[rng.choice(here, size=n, replace=len(here) < n)])
    stacked = np.stack(drawn)
    return (stacked - stacked.mean(axis=1, keepdims=True)).astype(np.float32)
