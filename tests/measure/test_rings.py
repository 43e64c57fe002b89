"""Round things shorter than their radius: measured where they are all that a scan shows, and found nowhere else."""

import numpy as np
import pytest

from cablejax.measure import MeasureError, measure_cable

DIAMETER_MM = 40.0


def ring(length_mm: float, n: int, *, noise_mm: float, arc_deg: float = 360.0) -> np.ndarray:
    """Points on a ring of 40 mm, turned and moved."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, np.radians(arc_deg), n)
    radius = DIAMETER_MM / 2 + noise_mm * rng.normal(size=n)
    xyz = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, length_mm, n)], axis=1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return xyz @ turn + 100.0


@pytest.mark.parametrize(("length_mm", "n"), [(3.0, 150), (4.0, 600), (16.0, 2000)])
def test_a_ring_seen_all_round_is_measured(length_mm: float, n: int):
    found = measure_cable(ring(length_mm, n, noise_mm=0.1))
    # Noise .1 over 150 points: a diameter to .016 mm, of which four, and no tube bent into the ring (3 mm).
    assert found.diameter_mm == pytest.approx(DIAMETER_MM, abs=0.07)
    assert found.length_mm == pytest.approx(
        length_mm, abs=1.2
    )  # tilted by .013 rad, of which two, a ring of 40 mm seems 1 mm longer
    assert any("shorter than two diameters" in warning for warning in found.warnings)


def test_a_short_arc_of_a_ring_is_not():
    with pytest.raises(MeasureError):
        measure_cable(ring(6.0, 800, noise_mm=0.1, arc_deg=100.0))


def test_a_ring_beside_other_things_is_none():
    other = np.random.default_rng(0).uniform(-60, 60, (1500, 3)) + 100.0
    with pytest.raises(MeasureError):
        measure_cable(np.concatenate([ring(6.0, 1500, noise_mm=0.1), other]))


def test_a_cable_that_lies_in_a_circle_is_no_ring():
    # 10 mm thick about a circle of 300 mm: all of its points lie within a thirtieth of that circle's radius.
    rng = np.random.default_rng(1)
    around, section = rng.uniform(0, 1.9 * np.pi, 20_000), rng.uniform(0, np.pi, 20_000)
    out = 150.0 + 5.0 * np.cos(section)
    xyz = np.stack([out * np.cos(around), out * np.sin(around), 5.0 * np.sin(section)], axis=1)
    found = measure_cable(xyz + 0.05 * rng.normal(size=xyz.shape))
    assert found.diameter_mm == pytest.approx(10.0, abs=0.1)
