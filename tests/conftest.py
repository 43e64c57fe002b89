"""Shared test set-up: a compilation cache beside the sources, cheap compiling, strict ranks, the real data's folder."""

import gc
import os
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

# Nearly all of the tests' time is compiling, which XLA's older emitters do at level 1 in little more than half of the time
# (processor seconds: knn 5.2 for 9.4, the quadric filter 10.3 for 17, a scanner's beams 3.6 for 6.1), for programs that
# run as fast; a program in one piece for LLVM, not in 32, takes a fifth off middling ones (ten: 1.9 for 2.5), not off large.
# Level 0 halves the rest, but its programs run 5 to 10 times slower, and one row of test_ragged.py's slow cloud then lacks
# its nearest neighbours, with AVX2 and AVX-512 alike. `make test-portable` sets flags of its own and so tests what users
# get. XLA aborts on a flag that it does not know, and 0.12 dropped the first one.
CHEAP = (
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1 --xla_cpu_parallel_codegen_split_count=1"
)
if jaxlib_version.__version__ in ("0.10.0", "0.10.1"):
    os.environ.setdefault("XLA_FLAGS", CHEAP)

import pytest

from cablejax.jax_sums import set_flag

set_flag()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scans, `$CABLEJAX_DATA`; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("CABLEJAX_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real scans not found: set CABLEJAX_DATA (looked in {folder})")
    return folder


# Where `make test` begins, with a file to each process in turn, so that no process is left alone with a long one at the end.
SLOWEST = (
    "ops/test_filters.py",
    "test_wheel.py",
    "test_notebooks.py",
    "cli/test_cli.py",
    "nets/test_networks.py",
    "simulate/test_surfaces.py",
    "batch/test_dask.py",
    "simulate/test_part_clouds.py",
    "ops/test_undetermined.py",
    "ops/test_switches.py",
    "cli/test_capacity.py",
    "ops/test_sharded.py",
    "batch/test_folder.py",
    "kinds/test_shell.py",
    "cli/test_gage.py",
    "experiments/harness/test_sweep.py",
    "nets/test_adgcnn_fit.py",
    "train/test_fit.py",
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
