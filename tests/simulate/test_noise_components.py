"""Each thing a scanner does to a range, alone, against the statistics its docstring claims."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import PRESETS, bare, make_tube
from cablejax.simulate.beams import Beam, gaussian, measure
from cablejax.simulate.presets import numbers_of
from cablejax.simulate.sweeps import RESWEPT_WINDOW, choose_rows, hang_in_air, raster, sweep_beams

RADIUS, STANDOFF, MANY = 20.0, 300.0, 20_000
TUBE = cache(
    partial(make_tube, "straight", diameter_mm=2 * RADIUS, length_mm=200.0)
)  # made when asked for, not on import
measure_many = jax.jit(jax.vmap(measure, in_axes=(None, 0, None, 0)))
sweep = jax.jit(sweep_beams, static_argnames=("lines", "columns"))
plan_of = jax.jit(raster, static_argnames="columns")


def numbers(**changes):
    """The ideal scanner's numbers, with changes."""
    return {**numbers_of(PRESETS["ideal"]), **{name: jnp.float32(value) for name, value in changes.items()}}


def returns(off_axis, *, distance=STANDOFF, seed=0, **changes):
    """One beam, many times, downwards past the axis at `off_axis`: ranges `[m]`, what came back, and its true range."""
    origin = jnp.tile(jnp.array([[3.0, off_axis, distance]], jnp.float32), (MANY, 1))
    down = jnp.tile(jnp.array([[0.0, 0.0, -1.0]]), (MANY, 1))
    luck = jax.random.uniform(jax.random.key(seed), (MANY, 6))
    back = measure_many(bare(TUBE()), Beam(origin, down), numbers(**changes), luck)
    true = distance - np.sqrt(max(RADIUS**2 - off_axis**2, 0.0))
    return distance - np.asarray(back.xyz_mm[:, 2], np.float64) - true, back, true


# a standard deviation from 20,000 draws is known to 0.5 %; 4 of those
STD = {"rel": 0.02}


@pytest.mark.parametrize("off_axis", [0.0, 10.0, 17.0])
@pytest.mark.parametrize("power", [0.0, 1.0])
def test_range_noise_grows_with_incidence(off_axis, power):
    error, back, _ = returns(off_axis, range_mm=0.2, incidence_power=power, standoff_mm=STANDOFF)
    cosine = np.sqrt(1 - (off_axis / RADIUS) ** 2)
    assert bool(back.valid.all())
    assert error.std() == pytest.approx(0.2 / cosine**power, **STD)
    assert error.mean() == pytest.approx(0.0, abs=4 * error.std() / MANY**0.5)


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_range_noise_grows_with_range(power):
    error, _, true = returns(0.0, distance=900.0, range_mm=0.1, range_power=power, standoff_mm=STANDOFF)
    assert error.std() == pytest.approx(0.1 * (true / STANDOFF) ** power, **STD)


def test_bias_is_added_to_every_range():
    error, _, _ = returns(5.0, range_bias_mm=0.3)
    assert np.allclose(error, 0.3, atol=1e-4)


def test_jitter_moves_the_range_on_a_slope():
    # at 45 degrees a tilt of d in the plane of the slope changes the range by range x d
    off_axis = RADIUS / 2**0.5
    error, _, true = returns(off_axis, jitter_mrad=0.2)
    assert error.std() == pytest.approx(true * 0.2e-3, rel=0.03)  # the curvature adds a little
    flat, _, _ = returns(0.0, jitter_mrad=0.2)
    assert flat.std() < 0.02 * error.std()


def test_ranges_come_in_counts():
    error, _, true = returns(3.0, range_mm=1.0, quantum_mm=0.5)
    steps = (error + true) / 0.5
    assert np.abs(steps - np.round(steps)).max() < 1e-3
    assert len(np.unique(np.round(steps))) > 5


@pytest.mark.parametrize(("cosine", "share"), [(0.2, 0.5), (0.3, 1 / (1 + np.exp(-2))), (0.1, 1 / (1 + np.exp(2)))])
def test_dropouts_follow_the_incidence(cosine, share):
    off_axis = RADIUS * np.sqrt(1 - cosine**2)
    _, back, _ = returns(off_axis, dropout_cos=0.2, dropout_width=0.05)
    assert float(back.valid.mean()) == pytest.approx(share, abs=4 * 0.5 / MANY**0.5)


@pytest.mark.parametrize("margin", [-0.2, 0.02, 0.2])
def test_mixed_pixels_lie_behind_the_rim(margin):
    footprint, depth, mixed = 0.4, 30.0, 0.6
    error, back, _ = returns(
        RADIUS - margin, footprint_mm=footprint, mixed_depth_mm=depth, mixed_share=mixed, dropout_cos=-9.0
    )
    is_mixed = np.asarray(back.is_mixed)
    assert is_mixed.mean() == pytest.approx(mixed, abs=4 * 0.5 / MANY**0.5)
    # a Gaussian footprint cut by a straight rim; the depth is uniform
    on_cable = {-0.2: 0.3085, 0.02: 0.5199, 0.2: 0.6915}[margin]
    most = (1 - on_cable) * depth
    behind = error[is_mixed]
    assert behind.mean() == pytest.approx(most / 2, rel=0.03)
    assert behind.max() == pytest.approx(most, rel=0.02)
    # the others return the cable where the beam's axis meets it and nothing where it does not
    assert bool(back.valid[~is_mixed].any()) == (margin > 0)


def test_no_mixed_pixels_far_from_the_rim():
    _, back, _ = returns(10.0, footprint_mm=0.4, mixed_depth_mm=30.0, mixed_share=1.0)
    assert not bool(back.is_mixed.any())


def test_each_sweep_is_shifted_as_a_whole():
    changed = numbers(registration_mm=0.5, resweep_share=0.3)
    angles, two_pi = jnp.array([0.5, 2.5, 4.5]), jnp.float32(2 * np.pi)
    shifts = []
    for seed in range(8):
        key = jax.random.key(seed)
        moved = sweep(bare(TUBE()), angles, two_pi, jnp.float32(0), changed, key, lines=20, columns=8)
        still = sweep(bare(TUBE()), angles, two_pi, jnp.float32(0), {**changed, "registration_mm": jnp.float32(0)}, key,
                      lines=20, columns=8)  # fmt: skip
        step = np.asarray(moved.xyz_mm - still.xyz_mm).reshape(3, 20, 8, 3)
        assert np.ptp(step[:, :14], axis=(1, 2)).max() < 1e-4  # 14 lines of the first sweep, 6 of the second
        assert np.ptp(step[:, 14:], axis=(1, 2)).max() < 1e-4
        shifts.append(step[:, [0, 19], 0])
    # 8 x 3 x 2 x 3 = 144 draws know a standard deviation to 6 %; 3.5 of those
    assert np.std(shifts) == pytest.approx(0.5, rel=0.2)


def test_repeated_sweep_covers_one_window():
    luck = jax.random.uniform(jax.random.key(1), (2, 104))
    plan = plan_of(jnp.float32(100.0), jnp.float32(0.0), jnp.float32(0.4), luck, columns=5)
    arc, again = np.asarray(plan.arc_mm).reshape(2, 100, 5), np.asarray(plan.sweep).reshape(2, 100, 5) == 1
    assert again.mean() == pytest.approx(0.4)
    for station in range(2):
        first, second = arc[station][~again[station]], arc[station][again[station]]
        assert np.ptp(second) == pytest.approx(100 * RESWEPT_WINDOW * 39 / 40, abs=1e-3)
        assert (first.min(), first.max()) == pytest.approx((100 * 0.5 / 60, 100 * 59.5 / 60), abs=1e-3)


def test_uneven_speed_keeps_order_and_ends():
    luck = jax.random.uniform(jax.random.key(2), (1, 404))
    plan = plan_of(jnp.float32(100.0), jnp.float32(0.9), jnp.float32(0.0), luck, columns=1)
    gaps = np.diff(np.asarray(plan.arc_mm))
    assert gaps.min() > 0
    assert gaps.max() / gaps.min() > 1.5
    assert 0 <= float(plan.arc_mm.min()) < float(plan.arc_mm.max()) <= 100


def test_outliers_hang_two_mm_and_an_exponential_off():
    air = jax.jit(hang_in_air, static_argnames="count")(TUBE(), jax.random.key(4), count=MANY)
    height = np.asarray(jax.vmap(TUBE().signed_distance)(air), np.float64) - 2.0
    assert height.min() > -1e-3
    assert height.mean() == pytest.approx(15.0, rel=0.03)
    assert np.median(height) == pytest.approx(15.0 * np.log(2), rel=0.04)


def test_too_few_returns_become_padding():
    back = sweep(bare(TUBE()), jnp.array([0.5, 2.5, 4.5]), jnp.float32(0.3), jnp.float32(0.5), numbers(),
                 jax.random.key(0), lines=20, columns=8)  # fmt: skip
    some = int(back.valid.sum())
    assert 0 < some < 100
    rows = jax.jit(choose_rows)(back, jnp.zeros((200, 3)) + 7.0, jnp.int32(10), jax.random.key(1))
    assert int(rows.is_outlier.sum()) == 10
    assert int(rows.is_padding.sum()) == 190 - some
    kept = np.asarray(rows.xyz_mm)[~np.asarray(rows.is_padding | rows.is_outlier)]
    assert np.array_equal(kept, np.asarray(back.xyz_mm)[np.asarray(back.valid)])


def test_gaussian_of_zero_is_finite():
    assert bool(jnp.isfinite(gaussian(jnp.array([0.0, 0.5, 1 - 2.0**-24]))).all())
