"""What a scanner does to a range: the numbers of a scanner, and presets that stand for kinds of instruments."""

import dataclasses
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array


@dataclass(frozen=True)
class Scanner:
    """A scanner's numbers. Ranges are in mm; c is the cosine of the angle between beam and surface normal.

    Attributes:
        standoff_mm: Distance from the cable's axis to the scanner.
        moving_head: True for a head that travels along the cable (an arm), False for one that stands still.
        range_mm: Standard deviation of the range at normal incidence and at `standoff_mm`.
        range_power: Noise grows with (range / standoff_mm)^range_power: 2 for triangulation, 1 for time of flight.
        incidence_power: Noise grows with c^-incidence_power (c not below 0.1).
        range_bias_mm: Added to every range; a translucent sheath is measured too far away.
        jitter_mrad: Standard deviation of the beam's direction, per axis.
        footprint_mm: Standard deviation of the beam's Gaussian footprint; the 1/e2 diameter is four of these.
        mixed_share: Share of beams split by the silhouette that return a mixed range, not the cable's own or none.
        mixed_depth_mm: Largest distance behind the cable that a mixed range averages with.
        dropout_cos: c at which half of the beams are lost.
        dropout_width: Width of that transition in c.
        quantum_mm: Step of the range counter, 0 for none.
        registration_mm: Standard deviation, per axis, of each sweep's shift after registration.
        resweep_share: Share of the beams spent on scanning one window of the length again.
        density_variation: Relative amplitude of the uneven speed along the cable, 0 to below 1.
        stands_for: The kind of instrument.
    """

    standoff_mm: float
    moving_head: bool
    range_mm: float
    range_power: float
    incidence_power: float
    range_bias_mm: float
    jitter_mrad: float
    footprint_mm: float
    mixed_share: float
    mixed_depth_mm: float
    dropout_cos: float
    dropout_width: float
    quantum_mm: float
    registration_mm: float
    resweep_share: float
    density_variation: float
    stands_for: str


PRESETS = {
    "ideal": Scanner(
        standoff_mm=300.0, moving_head=True, range_mm=0.0, range_power=0.0, incidence_power=0.0, range_bias_mm=0.0,
        jitter_mrad=0.0, footprint_mm=0.0, mixed_share=0.0, mixed_depth_mm=0.0, dropout_cos=0.0, dropout_width=0.01,
        quantum_mm=0.0, registration_mm=0.0, resweep_share=0.0, density_variation=0.0,
        stands_for="no instrument: points on the true surface, to rounding",
    ),
    "structured-light": Scanner(
        standoff_mm=400.0, moving_head=False, range_mm=0.05, range_power=2.0, incidence_power=1.0, range_bias_mm=0.0,
        jitter_mrad=0.05, footprint_mm=0.05, mixed_share=0.3, mixed_depth_mm=2.0, dropout_cos=0.2, dropout_width=0.04,
        quantum_mm=0.0, registration_mm=0.03, resweep_share=0.1, density_variation=0.2,
        stands_for="hand-held structured light: accuracy 0.05 mm, resolution 0.1 mm, as of an Artec Space Spider",
    ),
    "line-laser": Scanner(
        standoff_mm=250.0, moving_head=True, range_mm=0.1, range_power=2.0, incidence_power=1.0, range_bias_mm=0.0,
        jitter_mrad=0.2, footprint_mm=0.1, mixed_share=0.5, mixed_depth_mm=5.0, dropout_cos=0.15, dropout_width=0.04,
        quantum_mm=0.01, registration_mm=0.05, resweep_share=0.2, density_variation=0.3,
        stands_for="line laser on a measuring arm: 0.1 mm, as of a FARO Edge with its line probe",
    ),
    "terrestrial": Scanner(
        standoff_mm=3000.0, moving_head=False, range_mm=1.5, range_power=1.0, incidence_power=0.5, range_bias_mm=0.0,
        jitter_mrad=0.1, footprint_mm=1.0, mixed_share=0.8, mixed_depth_mm=60.0, dropout_cos=0.1, dropout_width=0.04,
        quantum_mm=0.1, registration_mm=1.0, resweep_share=0.1, density_variation=0.1,
        stands_for="terrestrial LiDAR: 1-3 mm, beam 4 mm wide, as of a Leica ScanStation P40 or a FARO Focus S70",
    ),
    "paper-floor": Scanner(
        standoff_mm=500.0, moving_head=True, range_mm=0.352, range_power=2.0, incidence_power=1.0, range_bias_mm=0.0,
        jitter_mrad=0.3, footprint_mm=0.15, mixed_share=0.5, mixed_depth_mm=5.0, dropout_cos=0.15, dropout_width=0.04,
        quantum_mm=0.01, registration_mm=0.15, resweep_share=0.2, density_variation=0.3,
        stands_for="a scan whose own deviation from the true surface has a standard deviation of 0.385 mm",
    ),
    "paper-aligned": Scanner(
        standoff_mm=500.0, moving_head=True, range_mm=0.38, range_power=2.0, incidence_power=1.0, range_bias_mm=0.0,
        jitter_mrad=0.3, footprint_mm=0.15, mixed_share=0.5, mixed_depth_mm=5.0, dropout_cos=0.15, dropout_width=0.04,
        quantum_mm=0.01, registration_mm=0.01, resweep_share=0.2, density_variation=0.3,
        stands_for="paper-floor with sweeps aligned as well as their noise allows, so that a filter can be judged",
    ),
}  # fmt: skip


def scanner(preset: str) -> Scanner:
    """The preset of that name.

    Raises:
        ValueError: If there is none.
    """
    if preset not in PRESETS:
        raise ValueError(f"preset: expected one of {', '.join(PRESETS)}, got {preset!r}")
    return PRESETS[preset]


def numbers_of(device: Scanner) -> dict[str, Array]:
    """The scanner's numbers as arrays, so that presets share one compiled program."""
    fields = dataclasses.asdict(device)
    return {name: jnp.float32(value) for name, value in fields.items() if not isinstance(value, str)}
