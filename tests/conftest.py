"""Shared test set-up: a compilation cache beside the sources, cheap compiling, strict ranks, the real data's folder."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# Set before jax is imported: the options are read once.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
# Code from the cache names processor features that are preferences, not instructions, and XLA calls each an error.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault("MPLBACKEND", "Agg")

from jaxlib import version as jaxlib_version

# Nearly all of the tests' time is compiling. XLA's older emitters at level 0, a program in one piece for LLVM, take a quarter
# of it (processor seconds of jaxlib 0.10.1: knn 2.0 for 5.2 at level 1 and 9.7 by default, the quadric filter 3.3 for 12.1 and
# 15.3), for programs that run 3 to 5 times slower, which matters where a test computes much: `optimized` compiles it at level 1.
# `make test-portable` sets flags of its own and so tests what users get. XLA aborts on a flag that it does not know, and
# 0.12 dropped the first one.
CHEAP = (
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1 --xla_cpu_parallel_codegen_split_count=1"
)
if "XLA_FLAGS" not in os.environ:
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "true")
    if jaxlib_version.__version__ in ("0.10.0", "0.10.1"):
        os.environ["XLA_FLAGS"] = CHEAP

import pytest

from cablejax.jax_sums import set_flag
from tests.compiling import compiled_for_speed

set_flag()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scans, `$CABLEJAX_DATA`; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("CABLEJAX_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real scans not found: set CABLEJAX_DATA (looked in {folder})")
    return folder


@pytest.fixture
def optimized() -> Iterator[None]:
    """Compile for speed what this test compiles."""
    with compiled_for_speed():
        yield


# Where `make test` begins, with a file to each process in turn, so that no process is left alone with a long one at the end.
SLOWEST = (
    "ops/test_undetermined.py",
    "cli/test_cli.py",
    "nets/test_networks.py",
    "ops/test_filters.py",
    "test_notebooks.py",
    "ops/test_neighbors_switches.py",
    "batch/test_dask.py",
    "test_wheel.py",
    "batch/test_folder.py",
    "ops/test_switches.py",
    "cli/test_schema.py",
    "app/test_stages.py",
    "experiments/display/test_display.py",
    "kinds/test_shell.py",
    "simulate/test_part_clouds.py",
    "nets/test_adgcnn_fit.py",
    "ops/test_neighbors.py",
    "measure/test_beam_noise.py",
    "test_programs.py",
    "tiles/test_denoise.py",
    "app/test_browser.py",
    "simulate/test_surfaces.py",
    "experiments/harness/test_sweep.py",
    "train/test_fit.py",
    "cli/test_gage.py",
    "ops/test_sharded.py",
    "train/test_devices.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The slowest files first; the order is otherwise kept."""
    rank = {ROOT / "tests" / name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


def pytest_collection_finish() -> None:
    """Collect garbage rarely: tracing makes millions of objects. Processor seconds of test_edges.py with a warm cache, twice
    on a busy machine: 9.3 and 8.3 before, 7.2 and 8.1 now."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)
