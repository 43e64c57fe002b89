"""Plain references for the measurement: scans of ideal cables, and textbook circle fits, in float64."""

import numpy as np
from scipy.optimize import least_squares


def bent_cable(
    *, radius=15.0, length=400.0, n=6000, noise=0.1, arc_deg=180.0, bend_radius=None, oval=0.0, seed=0
) -> np.ndarray:
    """Points on a cable along x, or on a circle of `bend_radius` in the x-y plane, the arc centred on +z.

    `oval` is the amplitude of the second harmonic of the radius in mm, greatest across z.
    """
    rng = np.random.default_rng(seed)
    along = rng.uniform(0, length, n)
    angle = np.radians(rng.uniform(-arc_deg / 2, arc_deg / 2, n))
    distance = radius - oval * np.cos(2 * angle)
    side, up = distance * np.sin(angle), distance * np.cos(angle)
    if bend_radius is None:
        xyz = np.stack([along, side, up], axis=1)
    else:
        turn = along / bend_radius
        xyz = np.stack(
            [(bend_radius + side) * np.sin(turn), (bend_radius + side) * np.cos(turn) - bend_radius, up], axis=1
        )
    return xyz + noise * rng.normal(size=xyz.shape)


def cylinder_by_scipy(xyz: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Straight cylinder near the x axis by SciPy: (y, z, slope y, slope z, radius), least squares of the true distance."""

    def residual(p: np.ndarray) -> np.ndarray:
        direction = np.array([1.0, p[2], p[3]]) / np.sqrt(1 + p[2] ** 2 + p[3] ** 2)
        offset = xyz - np.array([0.0, p[0], p[1]])
        return np.linalg.norm(np.cross(offset, direction), axis=1) - p[4]

    return least_squares(residual, start, xtol=1e-12, ftol=1e-12).x


def tube_distance(xyz: np.ndarray, bend_radius: float, radius: float) -> np.ndarray:
    """Signed distance to a torus about the circle of `bend_radius` in the x-y plane through the origin along x."""
    ring = np.hypot(xyz[:, 0], xyz[:, 1] + bend_radius) - bend_radius
    return np.hypot(ring, xyz[:, 2]) - radius
