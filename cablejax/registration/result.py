"""What a registration returns."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class RegistrationResult(NamedTuple):
    """A rigid motion with what is known about it.

    Small motions are twists (translation, rotation vector) about `center`, applied after `T_target_source`.

    Attributes:
        T_target_source: The motion `[4, 4]`, float64: it takes source points into the target's frame.
        converged: Whether the last step moved the points by less than the tolerance.
        iterations: Steps taken.
        inliers: Source points with a corresponding point within the largest distance.
        rmse: Root mean square distance between corresponding points, in the cloud's unit.
        status: Bits of `cablejax.types.Status`: `DEGENERATE` where some direction is not seen, `NOT_CONVERGED`, `EMPTY`.
        covariance: Of the twist about `center` `[6, 6]`, within the directions that are seen; zero across the others, of
            which the scans say nothing.
        observability: For six independent directions of motion, in ascending order `[6]`: the share of the points'
            squared displacement that is along their normals. 0 means that the surface slides on itself.
        directions: The twists of these directions `[6, 6]`, one a column, each moving the points by 1 (root mean square).
        seen: Which directions were moved along `[6]`.
        center: Centre of the target's inliers `[3]`.
        overlap: Share of the source points (of the thinned ones, in `register`) that have a corresponding point.
    """

    T_target_source: Float[np.ndarray, "4 4"]
    converged: bool
    iterations: int
    inliers: int
    rmse: float
    status: int
    covariance: Float[np.ndarray, "6 6"]
    observability: Float[np.ndarray, "6"]
    directions: Float[np.ndarray, "6 6"]
    seen: Bool[np.ndarray, "6"]
    center: Float[np.ndarray, "3"]
    overlap: float
