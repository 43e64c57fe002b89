"""Dark and glossy sheaths: what is lost and how much noisier the rest is, against the laws in the docstrings."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import PRESETS, Part, bare, catalogue, finish, make_tube, sheath_finish, simulate_scan
from cablejax.simulate.beams import Beam, measure
from cablejax.simulate.presets import numbers_of
from cablejax.simulate.sheath import GLARE_SINE

RADIUS, STANDOFF, MANY = 20.0, 300.0, 20_000
TUBE = cache(
    partial(make_tube, "straight", diameter_mm=2 * RADIUS, length_mm=200.0)
)  # made when asked for, not on import
measure_many = jax.jit(jax.vmap(measure, in_axes=(None, 0, None, 0)))


def returns(cosine, surfaces, **changes):
    """One beam many times at an angle of incidence: errors of the range, and which came back."""
    off_axis = RADIUS * np.sqrt(1 - cosine**2)
    origin = jnp.tile(jnp.array([[3.0, off_axis, STANDOFF]], jnp.float32), (MANY, 1))
    down = jnp.tile(jnp.array([[0.0, 0.0, -1.0]]), (MANY, 1))
    device = numbers_of(PRESETS["ideal"]) | {name: jnp.float32(value) for name, value in changes.items()}
    luck = jax.random.uniform(jax.random.key(0), (MANY, 6))
    back = measure_many(bare(TUBE())._replace(finish=surfaces), Beam(origin, down), device, luck)
    return STANDOFF - np.asarray(back.xyz_mm[:, 2]) - (STANDOFF - RADIUS * cosine), np.asarray(back.valid)


SHARE = {"abs": 4 * 0.5 / MANY**0.5}  # four standard deviations of a share


@pytest.mark.parametrize("cosine", [0.3, 0.8])
def test_a_dark_sheath_is_lost_where_lamberts_law_says(cosine):
    # detection is even where 0.25 c = 0.2, that is at c = 0.8; at 0.3 the signal of 0.075 is 2.5 widths short
    _, valid = returns(cosine, finish("dark"), dropout_cos=0.2, dropout_width=0.05)
    assert valid.mean() == pytest.approx(1 / (1 + np.exp(-(0.25 * cosine - 0.2) / 0.05)), **SHARE)


@pytest.mark.parametrize("sine", [0.0, 0.15, 0.3])
def test_a_glossy_sheath_dazzles_about_its_normal(sine):
    _, valid = returns(np.sqrt(1 - sine**2), sheath_finish(1.0, 0.6))
    assert valid.mean() == pytest.approx(1 - 0.6 * np.exp(-((sine / GLARE_SINE) ** 2)), **SHARE)


def test_noise_grows_as_the_root_of_the_missing_light():
    # 20,000 draws know a standard deviation to 0.5 %; 4 of those
    for surfaces, diffuse in ((finish("matte"), 1.0), (finish("dark"), 0.25), (sheath_finish(0.5, 0.5), 0.25)):
        error, _ = returns(0.6, surfaces, range_mm=0.1)
        assert error.std() == pytest.approx(0.1 / np.sqrt(diffuse), rel=0.02)


def test_only_sheaths_have_the_finish():
    dark = finish("dark")
    assert [dark.reflectance[part] for part in (Part.CABLE, Part.OTHER_CABLE, Part.WALL, Part.TRAY)] == [
        0.25,
        0.25,
        1,
        1,
    ]


def test_a_dark_scan_keeps_its_row_count_and_sees_less_of_the_sides():
    def angles(name):
        scan = simulate_scan(catalogue()[8], n_points=2000, stations=1, arc_deg=180.0, finish=name, outlier_fraction=0.0,
                             key=jax.random.key(0))  # fmt: skip
        assert (scan.xyz_mm.shape, scan.finish) == ((2000, 3), name)
        angle = np.abs(np.degrees(np.arctan2(scan.xyz_mm[:, 2], scan.xyz_mm[:, 1])) - 90)
        return angle[~np.asarray(scan.is_mixed)]

    assert np.quantile(angles("dark"), 0.95) < np.quantile(angles("matte"), 0.95) - 10


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: finish("pink"), "finish: expected one of matte, dark, glossy, dark-glossy, got 'pink'"),
        (lambda: sheath_finish(0.0, 0.5), "reflectance: expected a finite number above 0, got 0.0"),
        (lambda: sheath_finish(0.5, 1.0), "gloss: expected at least 0 and below 1, got 1.0"),
    ],
)
def test_refuses(call, words):
    with pytest.raises(ValueError, match=words):
        call()
