"""The geometric baseline of every network: a robust cylinder fit and the nearest nominal size. Nothing is learnt."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from cablejax.ops import cylinder_frame
from cablejax.simulate import Split
from cablejax.train import class_average_accuracy, confusion_matrix, overall_accuracy


@jax.jit
def _radii(xyz: jax.Array, mask: jax.Array) -> jax.Array:
    return jax.lax.map(lambda cloud: cylinder_frame(*cloud).fitted_radius, (xyz, mask))


def fitted_diameters(split: Split) -> Float[np.ndarray, " clouds"]:
    """Diameters in mm `[clouds]` of the gently bent cylinder fitted to each cloud; 0 where no fit was found."""
    return 2.0 * np.asarray(_radii(jnp.asarray(split.xyz), jnp.asarray(split.mask)))


def nearest_size(fitted_mm: Float[np.ndarray, " n"], nominal_mm: Sequence[float]) -> Int[np.ndarray, " n"]:
    """Number of the nearest nominal diameter `[n]`; `len(nominal_mm)`, which is no size, where the fit is 0.

    Example:
        >>> nearest_size(np.array([21.0, 30.1, 0.0]), (21.2, 23.0, 29.5)).tolist()
        [0, 2, 3]
    """
    nominal = np.asarray(nominal_mm)
    nearest = np.abs(fitted_mm[:, None] - nominal[None, :]).argmin(axis=1)
    return np.where(fitted_mm > 0, nearest, len(nominal))


def baseline(split: Split, nominal_mm: Sequence[float]) -> dict[str, float]:
    """Eqs. (20) and (21) of the fit on a split; a cloud without a fit counts as wrong."""
    predicted = nearest_size(fitted_diameters(split), nominal_mm)
    confusion = confusion_matrix(np.asarray(split.label), predicted, len(nominal_mm) + 1)
    return {
        "baseline_overall": overall_accuracy(confusion),
        "baseline_class_average": class_average_accuracy(confusion),
    }
