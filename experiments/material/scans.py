"""The scan that an experiment works on, simulated once per process, and how its points deviate from the truth."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cablejax.simulate import Cable, Scan, add_noise, catalogue, signed_distance, simulate_scan
from experiments.harness.schema import NoiseConfig, ScanConfig


def cable_of(size_mm2: float) -> Cable:
    """The 8.7/15 kV cable of a nominal cross-section.

    Raises:
        ValueError: If the catalogue holds no such cross-section.
    """
    cables = {cable.size_mm2: cable for cable in catalogue()}
    if size_mm2 not in cables:
        raise ValueError(f"size_mm2: expected one of {', '.join(f'{s:g}' for s in cables)}, got {size_mm2:g}")
    return cables[size_mm2]


@lru_cache(maxsize=16)  # all seeds of a sweep, whose innermost key they are
def _bare_scan(preset: str, n: int, size_mm2: float, shape: str, arc_deg: float, outliers: float, seed: int) -> Scan:
    return simulate_scan(
        cable_of(size_mm2),
        n_points=n,
        preset=preset,
        shape=shape,
        arc_deg=arc_deg,
        outlier_fraction=outliers,
        key=jax.random.fold_in(jax.random.key(seed), 0),
    )


def make_scan(scan: ScanConfig, noise: NoiseConfig, *, seed: int) -> Scan:
    """Simulate the configured scan and add the configured noise (streams 0 and 1 of the seed)."""
    bare = _bare_scan(scan.preset, scan.n_points, scan.size_mm2, scan.shape, scan.arc_deg, scan.outlier_fraction, seed)
    if noise.kind == "none":
        return bare
    return add_noise(bare, kind=noise.kind, snr_db=noise.snr_db, key=jax.random.fold_in(jax.random.key(seed), 1))


def signed_distance_mm(scan: Scan, xyz_mm: np.ndarray) -> np.ndarray:
    """Signed distance of points `[n, 3]` to a scan's true surface `[n]` in mm, negative inside.

    Give all points and choose afterwards: every other number of points is compiled anew.
    """
    return np.asarray(signed_distance(scan.surface, jnp.asarray(xyz_mm, dtype=jnp.float32)))


def section_coordinates_mm(scan: Scan, xyz_mm: np.ndarray) -> np.ndarray:
    """Points `[n, 3]` unbent: two coordinates across the cable and one along it, from the middle, all in mm."""
    place = jax.vmap(scan.surface.locate)(jnp.asarray(xyz_mm, dtype=jnp.float32))
    radius = place.signed_distance_mm + place.radius_mm
    along = place.arc_mm - scan.surface.length_mm / 2
    return np.asarray(jnp.stack([radius * jnp.cos(place.angle), radius * jnp.sin(place.angle), along], axis=1))


class Deviation(NamedTuple):
    """Signed distances to the true surface as Tables 2 and 3 sum them up."""

    mean_mm: float
    std_mm: float
    within_percent: float

    @classmethod
    def of(cls, signed_mm: np.ndarray, *, tolerance_mm: float) -> "Deviation":
        """Mean, standard deviation and share within +-tolerance of signed distances `[n]` in mm."""
        within = np.abs(signed_mm) <= tolerance_mm
        return cls(float(signed_mm.mean()), float(signed_mm.std()), 100 * float(within.mean()))
