"""Many shapes in one process: few programs, and room for them."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax import PointCloud, capacity_for, make_room, types
from cablejax.ops import adaptive_filter, clean, knn

MAPS = Path("/proc/self/maps")
needs_maps = pytest.mark.skipif(not MAPS.exists(), reason="counts memory maps as Linux does")


def maps():
    return MAPS.read_bytes().count(b"\n")


@needs_maps
@pytest.mark.usefixtures("optimized")
def test_clouds_of_two_hundred_sizes_run_few_programs():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2300, 3)).astype(np.float32)
    sizes, held = range(1950, 2150), []
    for n in sizes:  # on both sides of the size from which a tree is built
        cloud = PointCloud.from_xyz(points[:n])
        assert int(clean(cloud, k=8, order=0).keep.sum()) > 0.9 * n
        assert np.isfinite(np.asarray(adaptive_filter(cloud, k=8, order=0).xyz)).all()
        assert (np.asarray(knn(cloud.xyz, k=8, mask=cloud.mask).neighbors)[:n] < n).all()
        held.append(maps())
    assert len({capacity_for(n) for n in sizes}) == 2
    after_both = held[list(sizes).index(2049)]
    assert held[-1] < after_both + 100  # none of the hundred sizes after that compiled anything


@needs_maps
def test_programs_are_let_go_before_there_is_no_room(monkeypatch):
    f = jax.jit(lambda x: jnp.sort(x) + 1)
    f(jnp.zeros(7))
    assert f._cache_size() == 1
    assert not make_room(full=1.0)  # the process runs, so there are maps left
    assert f._cache_size() == 1
    assert make_room(full=1e-6)
    assert f._cache_size() == 0
    np.testing.assert_array_equal(f(jnp.zeros(7)), 1)


@needs_maps
def test_each_capacity_is_looked_at_again_after_programs_were_let_go(monkeypatch):
    asked = []
    monkeypatch.setattr(types, "make_room", lambda: asked.append(True) or len(asked) == 2)
    monkeypatch.setattr(types, "_MET", set())
    for n in (5, 5, 6, 5, 6):
        PointCloud.from_xyz(np.zeros((n, 3)))
    assert len(asked) == 3  # 5, then 6 with programs let go, then 5 again


def test_a_system_that_does_not_count_maps_is_left_alone(monkeypatch, tmp_path):
    monkeypatch.setattr("cablejax.programs.MAPS", tmp_path / "none")
    assert not make_room(full=1e-6)
