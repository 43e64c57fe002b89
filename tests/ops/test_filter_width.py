"""The width chosen for the filter, from trials that are written down."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cablejax.ops import KnnResult, Trial, adaptive_filter, choose_alpha, pilot_places, usual_noise
from cablejax.ops.filter_width import LIFT, PILOT, SHARES, pilot_rows
from cablejax.types import PointCloud

M = 400
alpha_of = jax.jit(choose_alpha)


def trial(loss, noise=0.01, local=1.0):
    """The same loss for every point, a little scattered, so that the best is known."""
    scatter = 1 + 0.01 * np.random.default_rng(0).normal(size=M)
    noise = np.broadcast_to(np.asarray(noise), (len(SHARES),))
    return Trial(
        jnp.asarray(np.outer(loss, scatter), jnp.float32),
        jnp.asarray(np.outer(noise, np.ones(M)), jnp.float32),
        jnp.full(M, local, jnp.float32),
    )


def valley(place, depth=1.0):
    """Losses that are a parabola in the logarithm of the width."""
    return depth + 0.3 * (np.arange(len(SHARES)) - place) ** 2


@pytest.mark.parametrize("place", [2.0, 4.3, 7.8])
def test_the_lowest_loss_is_found_between_the_widths(place):
    share = SHARES[0] * 1.25**place
    np.testing.assert_allclose(alpha_of(trial(valley(place))), share, rtol=0.02)


def test_the_width_grows_where_the_noise_is_no_longer_small():
    share = SHARES[5]
    expected = share * np.sqrt(1 + LIFT * (0.4 / share) ** 4)
    np.testing.assert_allclose(alpha_of(trial(valley(5.0), noise=0.4)), expected, rtol=0.02)


def test_a_kernel_narrower_than_the_noise_is_not_believed():
    loss = valley(6.0)
    loss[:2] = 0.1
    noise = np.where(np.arange(len(SHARES)) < 2, 0.5, 0.05)
    np.testing.assert_allclose(alpha_of(trial(loss, noise=noise)), SHARES[6], rtol=0.02)


def test_one_point_in_a_hundred_does_not_count():
    strays = trial(valley(5.0))
    loss = strays.loss.at[:, :3].set(jnp.asarray(1e3 * valley(11.0), jnp.float32)[:, None])
    np.testing.assert_allclose(alpha_of(strays._replace(loss=loss)), alpha_of(strays), rtol=0.02)


def test_rows_without_a_point_do_not_count_and_none_gives_one():
    plain = trial(valley(5.0))
    more = Trial(
        jnp.concatenate([plain.loss, jnp.full((len(SHARES), 50), 7.0)], axis=1),
        jnp.concatenate([plain.noise, jnp.full((len(SHARES), 50), 7.0)], axis=1),
        jnp.concatenate([plain.local, jnp.zeros(50)]),
    )
    np.testing.assert_allclose(alpha_of(more), alpha_of(plain), rtol=1e-4)
    assert float(alpha_of(trial(valley(5.0), local=0.0))) == 1.0


def test_usual_noise_is_a_tenth_percentile_at_the_width():
    scattered = trial(valley(5.0))
    noise = jnp.asarray(np.outer(np.arange(1, len(SHARES) + 1), np.linspace(0, 1, M)), jnp.float32)
    got = usual_noise(scattered._replace(noise=noise), jnp.float32(np.sqrt(SHARES[3] * SHARES[4])))
    np.testing.assert_allclose(got, 0.1 * 4.5, rtol=1e-3)


def test_no_gradient_flows():
    plain = trial(valley(5.0))
    assert not np.asarray(jax.grad(lambda loss: alpha_of(plain._replace(loss=loss)))(plain.loss)).any()


@pytest.mark.parametrize("count", [0, 1, 100, PILOT - 1, PILOT, PILOT + 1, 53_135, 2_000_000_000])
def test_places_are_even_and_within_the_points(count):
    places = np.asarray(pilot_places(count)).astype(np.int64)
    used = min(count, PILOT)
    np.testing.assert_array_equal(places[:used], np.arange(used) * max(count, PILOT) // PILOT if count else [])
    assert (places[used:] == -1).all()


def test_rows_are_those_of_the_points_whatever_lies_between():
    rng = np.random.default_rng(0)
    valid = rng.random(3 * PILOT) < 0.6
    rows = np.nonzero(valid)[0]
    expected = rows[np.asarray(pilot_places(len(rows)))]
    np.testing.assert_array_equal(pilot_rows(jnp.asarray(valid)), expected)
    padded = np.concatenate([valid, np.zeros(500, bool)])
    np.testing.assert_array_equal(pilot_rows(jnp.asarray(padded)), expected)
    few = np.isin(np.arange(50), [3, 7])
    np.testing.assert_array_equal(np.asarray(pilot_rows(jnp.asarray(few)))[:3], [3, 7, -1])


def test_padding_and_rows_without_a_point_do_not_change_the_width():
    """2,500 points in 2,500 rows and in 4,096, there spread among rows that are none."""
    rng = np.random.default_rng(1)
    angle, along = rng.uniform(0, np.pi, 2500), rng.uniform(0, 60, 2500)
    radius = 10 + rng.normal(0, 0.2, 2500)
    xyz = np.stack([along, radius * np.cos(angle), radius * np.sin(angle)], axis=1).astype(np.float32)
    rows = np.sort(rng.choice(4096, 2500, replace=False))
    spread, mask = np.zeros((4096, 3), np.float32), np.zeros(4096, bool)
    spread[rows], mask[rows] = xyz, True
    near = cKDTree(xyz).query(xyz, 25)[1][:, 1:]

    def filtered(points, mask, where):
        """At some rows of a cloud; the search, which is not what is tested, by SciPy."""
        neighbors = np.full((len(points), 24), -1, np.int32)
        neighbors[where] = where[near]
        nothing = jnp.zeros(len(points), jnp.int32)
        found = KnnResult(jnp.asarray(neighbors), jnp.zeros(neighbors.shape, jnp.float32), nothing)
        return adaptive_filter(PointCloud(jnp.asarray(points), jnp.asarray(mask)), order=1, found=found)

    tight, loose = filtered(xyz, np.ones(2500, bool), np.arange(2500)), filtered(spread, mask, rows)
    np.testing.assert_allclose(np.asarray(loose.xyz)[rows], tight.xyz, atol=1e-4)
    np.testing.assert_allclose(np.asarray(loose.width)[rows], tight.width, rtol=1e-4)
