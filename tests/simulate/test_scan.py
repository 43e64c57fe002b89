"""Scans: exact row counts, exact truth, determinism, and what the presets promise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import Part, add_noise, catalogue, noise_mm, simulate_scan

CABLE = catalogue()[8]
N = 4000


def scan(seed=0, **options):
    return simulate_scan(CABLE, **{"n_points": N, "shape": "bend", "key": jax.random.key(seed), **options})


@pytest.mark.parametrize("shape", ["straight", "bend", "s-bend", "catenary"])
def test_ideal_points_lie_on_the_surface(shape):
    ideal = scan(preset="ideal", shape=shape, outlier_fraction=0.0)
    assert ideal.xyz_mm.shape == (N, 3)
    # coordinates up to 200 mm are known to 1.5e-5 mm in float32; distances add a few such roundings
    assert float(jnp.abs(ideal.signed_distance_mm).max()) < 1e-4
    assert not bool(ideal.is_outlier.any() | ideal.is_mixed.any() | ideal.is_impulse.any())


def test_outliers_are_counted_flagged_and_off_the_surface():
    noisy = scan(outlier_fraction=0.1)
    assert int(noisy.is_outlier.sum()) == 400
    assert bool((noisy.part == jnp.where(noisy.is_outlier, Part.AIR, Part.CABLE)).all())
    assert float(noisy.signed_distance_mm[noisy.is_outlier].min()) > 1.99
    assert not bool((noisy.is_mixed & noisy.is_outlier).any())


def test_same_key_same_bytes_other_key_other_points():
    first, again, other = scan(3), scan(3), scan(4)
    assert first.xyz_mm.tobytes() == again.xyz_mm.tobytes()
    both = np.concatenate([first.xyz_mm, other.xyz_mm])
    assert len(np.unique(both, axis=0)) == len(both)


def test_rows_are_distinct_points():
    points = np.asarray(scan(outlier_fraction=0.0).xyz_mm)
    assert len(np.unique(points, axis=0)) == N


def test_paper_floor_has_the_papers_deviation():
    # 0.385 mm over all points of the cable; sweeps move by 0.15 mm, six of them, so that one scan is +-0.015 about it
    stds = []
    for seed in range(6):
        floor = scan(seed, preset="paper-floor")
        stds.append(float(floor.signed_distance_mm[~floor.is_outlier].std()))
    assert np.mean(stds) == pytest.approx(0.385, abs=0.02)


def test_arc_limits_the_seen_circumference():
    part = scan(preset="ideal", shape="straight", arc_deg=90.0, stations=1, outlier_fraction=0.0)
    angle = np.degrees(np.arctan2(part.xyz_mm[:, 2], part.xyz_mm[:, 1]))
    assert angle.min() >= 45 - 0.01
    assert angle.max() <= 135 + 0.01
    assert np.ptp(angle) > 85


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"n_points": 0}, "n_points"),
        ({"preset": "radar"}, "preset: expected one of ideal"),
        ({"shape": "knot"}, "shape: expected one of straight"),
        ({"length_mm": -1.0}, "length_mm"),
        ({"bend_radius_mm": 30.0}, "bend_radius_mm: expected at least 2 diameters, 68.4"),
        ({"arc_deg": 0.0}, "arc_deg"),
        ({"stations": 0}, "stations"),
        ({"outlier_fraction": 1.0}, "outlier_fraction"),
    ],
)
def test_refuses(options, word):
    with pytest.raises(ValueError, match=word):
        scan(**options)


@pytest.mark.parametrize("kind", ["gaussian", "random", "compound"])
def test_noise_has_the_stated_power(kind):
    clean = scan(preset="ideal", outlier_fraction=0.0)
    noisy = add_noise(clean, kind=kind, snr_db=40.0, key=jax.random.key(9))
    points = np.asarray(clean.xyz_mm, np.float64)
    step = np.asarray(noisy.xyz_mm, np.float64) - points
    signal = np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))
    snr = 10 * np.log10(signal / np.mean(np.sum(step**2, axis=1)))
    # 5 % of 4,000 points carry the impulses: 200 of them know the power to about 5 %, 0.2 dB; allowed 4 times that
    assert snr == pytest.approx(40.0, abs=0.8 if kind != "gaussian" else 0.15)
    if kind == "random":  # uniform within the reach that gives the power: 600 draws come near its end, and none beyond
        reach = np.sqrt(3 / 0.05) * float(noise_mm(clean.xyz_mm, 40.0))
        assert 0.97 * reach < np.abs(step).max() <= reach + 1e-4
        assert np.abs(step[step != 0]).mean() == pytest.approx(reach / 2, rel=0.1)
    moved = np.any(step != 0, axis=1)
    expected = {"gaussian": 1.0, "random": 0.05, "compound": 1.0}[kind]
    assert moved.mean() == pytest.approx(expected, abs=0.02)
    assert float(noisy.is_impulse.mean()) == pytest.approx(0.0 if kind == "gaussian" else 0.05, abs=0.02)


def test_noise_refuses():
    clean = scan(preset="ideal")
    with pytest.raises(ValueError, match="kind: expected one of gaussian, random, compound, got 'pink'"):
        add_noise(clean, kind="pink", snr_db=60.0, key=jax.random.key(0))
    with pytest.raises(ValueError, match="impulse_share"):
        add_noise(clean, snr_db=60.0, impulse_share=0.0, key=jax.random.key(0))
