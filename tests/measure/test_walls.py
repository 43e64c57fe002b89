"""What lies on two surfaces, fills a solid, or runs back into itself."""

import numpy as np
import pytest

from cablejax.measure import MeasureSettings, SearchLimits, measure_cable
from cablejax.measure.accept import accepted
from cablejax.measure.find.cables import find_cables
from cablejax.measure.find.cylinder import Cylinder
from cablejax.measure.find.surface import surface
from cablejax.measure.find.track import follow
from cablejax.measure.fit.axis import sampled
from cablejax.measure.fit.least_squares import fit_cable
from cablejax.measure.scan import scan_of
from cablejax.measure.shape.ends import extent
from cablejax.measure.shape.walls import filled, two_walls

RADIUS, LENGTH = 15.0, 200.0
LINE = sampled(np.array([[0.0, 0, 0], [LENGTH, 0, 0]]), step=3.0)


def tube(radius: float, n: int, *, arc: float = 360.0, noise: float = 0.1, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    along, angle = rng.uniform(0, LENGTH, n), np.radians(rng.uniform(-arc / 2, arc / 2, n))
    rough = radius + noise * rng.normal(size=n)
    return np.stack([along, rough * np.cos(angle), rough * np.sin(angle)], axis=1)


def loop(n: int = 12_000, *, radius: float = 8.0, turn: float = 90.0) -> np.ndarray:
    """A hose in a closed circle."""
    rng = np.random.default_rng(2)
    t, b = rng.uniform(0, 2 * np.pi, (2, n))
    out = turn + radius * np.cos(b)
    return np.stack([out * np.cos(t), out * np.sin(t), radius * np.sin(b)], axis=1) + 0.05 * rng.normal(size=(n, 3))


@pytest.mark.parametrize("seed", range(3))
def test_of_two_walls_the_outer_is_measured_unless_the_inner_is_sought(seed):
    xyz = np.concatenate([tube(15.0, 4000, seed=seed), tube(12.0, 3000, seed=seed + 10)])
    outer = measure_cable(xyz)
    assert outer.interval_mm[0] < 30 < outer.interval_mm[1]
    assert outer.std_mm < 0.05
    assert any("surface lies within this one, 24" in warning for warning in outer.warnings)
    assert not outer.keep[4000:].any()
    inner = measure_cable(xyz, settings=MeasureSettings(limits=SearchLimits(diameter_mm=(20.0, 27.0))))
    assert inner.interval_mm[0] < 24 < inner.interval_mm[1]
    assert any("surface lies about this one, 30" in warning for warning in inner.warnings)


@pytest.mark.parametrize(
    "one_surface",
    [
        tube(RADIUS, 6000, noise=1.0),
        tube(RADIUS, 6000) * [1.0, 1.0, 0.9],  # oval
        tube(RADIUS, 6000) * (1 + np.array([[0.0, 1, 1]]) * (tube(RADIUS, 6000)[:, :1] / LENGTH - 0.5) * 0.2),  # taper
        tube(RADIUS, 6000, noise=0.0)
        * (1 + 1e-7 * np.where(np.arange(6000) % 2, 1, -1)[:, None] * [0, 1, 1]),  # two last bits
        np.round(tube(RADIUS, 6000) / 2.0) * 2.0,  # on a coarse grid, whose levels differ from place to place
    ],
    ids=["noise", "oval", "taper", "rounding", "grid"],
)
def test_one_surface_is_not_taken_for_two(one_surface):
    assert two_walls(fit_cable(one_surface, LINE, RADIUS)) is None


def test_a_step_along_the_length_is_not_taken_for_two_walls():
    xyz = np.concatenate([tube(15.0, 4000), tube(16.5, 4000, seed=1) + np.array([LENGTH, 0, 0])])
    line = sampled(np.array([[0.0, 0, 0], [2 * LENGTH, 0, 0]]), step=3.0)
    assert two_walls(fit_cable(xyz, line, RADIUS)) is None


def test_a_surface_stands_out_and_a_solid_does_not():
    rough = tube(RADIUS, 6000, noise=0.3 * RADIUS)
    assert filled(rough, fit_cable(rough, LINE, RADIUS)) is None
    rng = np.random.default_rng(0)
    solid = rng.uniform(-1, 1, (60_000, 3)) * [LENGTH, 45, 45] + [LENGTH / 2, 0, 0]
    shell = np.abs(np.hypot(solid[:, 1], solid[:, 2]) - RADIUS) < 4  # what a fit within the solid holds on to
    ratio = filled(solid, fit_cable(solid[shell], LINE, RADIUS))
    assert ratio is not None
    assert ratio > 0.5


def test_a_solid_is_refused_where_it_passes_for_a_cylinder(monkeypatch: pytest.MonkeyPatch):
    # Whether a search finds a tube in a solid hangs on the draw; here one that was found is judged.
    xyz = tube(RADIUS, 6000)
    scan = scan_of(xyz, station=None, on_cable=None, limits=SearchLimits())
    find = find_cables(scan.xyz, rng=np.random.default_rng(0))
    assert accepted(scan, find.tracks[0], find, MeasureSettings()).other_mm is None
    monkeypatch.setattr("cablejax.measure.accept.filled", lambda xyz, fit: 0.5)
    with pytest.raises(ValueError, match=r"stands out of nothing: points lie about it as densely as on it"):
        accepted(scan, find.tracks[0], find, MeasureSettings())


def test_a_closed_loop_is_followed_once():
    xyz = loop()
    thinned = surface(xyz, target=6000, k=16)
    track = follow(thinned, Cylinder(np.array([90.0, 0, 0]), np.array([0.0, 1, 0]), 8.0))
    assert track is not None
    around = 2 * np.pi * 90
    assert 0.95 * around < track.length_mm < 1.1 * around
    result = measure_cable(xyz)
    assert result.interval_mm[0] < 16 < result.interval_mm[1]
    assert 0.9 * around < result.length_mm < 1.05 * around


@pytest.mark.parametrize("seed", range(5))
def test_a_thinly_scanned_stretch_is_no_end(seed):
    # As dense as 2.3 to 1: some 90 and 39 points a slab of 72 bins.
    rng = np.random.default_rng(seed)
    along = np.concatenate([rng.uniform(0, 300, 3800), rng.uniform(300, 700, 2200)])
    low, high = extent(along, rng.uniform(0, 2 * np.pi, 6000), radius_mm=RADIUS)
    assert low < 20
    assert high > 660
