"""Which way the points face: small things that lie in a heap may keep near a large cylinder, and face everywhere."""

import numpy as np
from jaxtyping import Float

from cablejax.measure.find.surface import surface
from cablejax.measure.fit.axis import locate, point_at
from cablejax.measure.fit.least_squares import CableFit

WIDE = 0.5  # radii that a normal's neighbours may reach
DETERMINED = 4.0  # times the scatter about their plane that they must reach, for the normal to be more than noise
AROUND = 1.6  # radii about the axis that neighbours come from
NEAR = 2.5  # standard deviations from the surface within which a point's normal counts
OUTWARD = 0.82  # median cosine; scans of cans, motors and stems .88 to 1.00, a heap of pins .55 to .68


def faces_elsewhere(xyz: Float[np.ndarray, "n 3"], fit: CableFit) -> float | None:
    """The median cosine between normals and the direction from the axis, where it is no cylinder's; None where it is.

    Args:
        xyz: All points of the scan, mm.
        fit: The fit of axis and radius.
    """
    box = AROUND * fit.radius_mm
    near = (xyz > fit.axis.xyz.min(axis=0) - box).all(axis=1) & (xyz < fit.axis.xyz.max(axis=0) + box).all(axis=1)
    place = locate(fit.axis, xyz[near])
    beside = (np.hypot(place.u, place.v) < box) & (place.s > 0) & (place.s < fit.axis.length_mm)
    thinned = surface(xyz[near][beside])
    if not DETERMINED * thinned.roughness_mm < thinned.reach_mm < WIDE * fit.radius_mm:
        return None
    place = locate(fit.axis, thinned.xyz)
    out = thinned.xyz - point_at(fit.axis, place._replace(u=np.zeros_like(place.u), v=np.zeros_like(place.v)))
    distance = np.linalg.norm(out, axis=1)
    on = np.abs(distance - fit.radius_mm) < NEAR * max(fit.noise_mm, 1e-3 * fit.radius_mm)
    cosine = np.abs(np.einsum("ij,ij->i", thinned.normals[on], out[on])) / distance[on]
    median = float(np.median(cosine)) if on.any() else 1.0
    return median if median < OUTWARD else None
