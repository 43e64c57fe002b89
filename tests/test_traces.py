"""Traces that processes share: read instead of made anew, the same bits, and never those of other code or shapes."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cablejax.traces
from cablejax import PointCloud
from cablejax.io import write_points
from cablejax.tiles import Settings, denoise_file, kernels, work
from cablejax.traces import Traced
from tests.reference.circles import bent_cable

pytest.importorskip("flatbuffers")


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A fresh cache of compiled programs."""
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "traces"
    jax.config.update("jax_compilation_cache_dir", before)


def counted():
    """A function, and how often it was traced."""
    times = []

    @jax.jit
    def plus(x, y):
        times.append(1)
        return x + 2 * y

    return plus, times


def test_another_process_reads_what_one_has_traced(kept):
    x = jnp.arange(3.0)
    plus, times = counted()
    assert Traced(plus)(x, x).tolist() == [0, 3, 6]
    assert (len(times), len(list(kept.iterdir()))) == (1, 1)
    other, again = counted()
    assert Traced(other)(x, x).tolist() == [0, 3, 6]
    assert again == []
    Traced(other)(jnp.arange(4.0), x[0])  # of another shape
    assert (len(again), len(list(kept.iterdir()))) == (1, 2)


@pytest.mark.parametrize("change", ["sources", "jax", "damage"])
def test_what_may_be_another_program_is_traced_anew(kept, monkeypatch, change):
    x = jnp.arange(3.0)
    plus, _ = counted()
    Traced(plus)(x, x)
    match change:
        case "sources":
            monkeypatch.setattr(cablejax.traces, "_sources", lambda: "other code")
        case "jax":
            monkeypatch.setattr(jax, "__version__", "99")
        case "damage":
            (path,) = kept.iterdir()
            path.write_bytes(path.read_bytes()[:-1])
    other, again = counted()
    assert Traced(other)(x, x).tolist() == [0, 3, 6]
    assert len(again) == 1


@pytest.mark.parametrize("without", ["cache", "flatbuffers"])
def test_without_a_place_or_a_package_all_is_traced(kept, monkeypatch, without):
    if without == "cache":
        jax.config.update("jax_compilation_cache_dir", None)
    else:
        monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    plus, times = counted()
    assert Traced(plus)(jnp.arange(3.0), jnp.arange(3.0)).tolist() == [0, 3, 6]
    assert (len(times), kept.exists()) == (1, False)


def test_programs_are_let_go_where_room_runs_out(kept, monkeypatch):
    """A loop over scans of many sizes would hold the programs of all, and XLA aborts when the memory maps run out."""
    one, other = Traced(counted()[0]), Traced(counted()[0])
    for traced in (one, other):
        traced(jnp.arange(3.0), jnp.arange(3.0))
    assert (len(one._programs), len(other._programs)) == (1, 1)
    monkeypatch.setattr(cablejax.traces, "make_room", lambda: True)
    one(jnp.arange(4.0), jnp.arange(4.0))
    assert (len(one._programs), len(other._programs)) == (1, 0)


def test_a_tile_has_the_same_bits_traced_and_read(kept):
    cloud = PointCloud.from_xyz(bent_cable(n=900).astype(np.float32), capacity=1024)
    direct = kernels.scores._function(cloud, removal_k=8)
    for _ in range(2):  # traced and kept, then read
        found = Traced(kernels.scores._function)(cloud, removal_k=8)
        assert all(np.array_equal(a, b) for a, b in zip(found, direct, strict=True))


def test_the_work_on_tiles_finds_every_program_loaded_beforehand(kept, tmp_path, monkeypatch):
    """What `warm` loads is what the work calls: other shapes or types would be a program more."""
    all_ = (kernels.scores, kernels.nearest, kernels.width_trial, kernels.smooth)
    for each in all_:
        monkeypatch.setattr(each, "_programs", {})
    options = {"removal_k": 4, "k": 8, "order": 1, "refinements": 1}
    work.warm(capacity=512, smooth=True, **options)
    loaded = [set(each._programs) for each in all_]
    assert [len(each) for each in loaded] == [1, 1, 1, 1]
    xyz = np.concatenate([bent_cable(n=900), [[200.0, 60.0, 60.0], [150.0, -60.0, 60.0]]])
    write_points(tmp_path / "scan.ply", xyz)
    stages = set()
    denoise_file(
        tmp_path / "scan.ply",
        tmp_path / "out.ply",
        settings=Settings(**options),
        tile_points=512,
        progress=lambda stage, *_: stages.add(stage),
    )
    assert {"scoring", "strays", "width", "smoothing"} <= stages
    assert [set(each._programs) for each in all_] == loaded


def test_every_kernel_of_a_tile_can_be_kept(kept):
    """What they take and give is known to `jax.export` in a process that only reads."""
    code = (
        "import jax, sys, numpy as np, jax.numpy as jnp; jax.config.update('jax_compilation_cache_dir', sys.argv[1])\n"
        "from cablejax import PointCloud; from cablejax.tiles import kernels; from tests.reference.circles import bent_cable\n"
        "cloud = PointCloud.from_xyz(bent_cable(n=400).astype(np.float32), capacity=512)\n"
        "one = jnp.float32(1)\n"
        "kernels.smooth(cloud, cloud.mask, one, one, k=8, order=0, refinements=1).need\n"
        "kernels.width_trial(cloud, cloud.mask, jnp.zeros(8, jnp.int32), k=8, order=1)._fields\n"
        "kernels.nearest(cloud, cloud.xyz[:16], removal_k=4).shape\n"
    )
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code, str(kept.parent)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert len(list(kept.iterdir())) == 3
