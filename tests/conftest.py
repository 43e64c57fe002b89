"""Shared test set-up: a compilation cache beside the sources, cheap compiling, strict ranks, the real data's folder."""

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

import pytest
from jaxlib import version as jaxlib_version

from cablejax.jax_sums import set_flag

# Nearly all of the tests' time is compiling, and unoptimised code of XLA's older emitters costs a quarter of what users
# get (knn 2.2 s for 9.4 s, the quadric filter 4.0 s for 17 s), though it runs 5 times slower. `make test-portable` sets
# flags of its own and so compiles in full. XLA aborts on a flag that it does not know, and 0.12 dropped the first one.
CHEAP = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
if jaxlib_version.__version__ in ("0.10.0", "0.10.1"):
    os.environ.setdefault("XLA_FLAGS", CHEAP)
set_flag()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scans, `$CABLEJAX_DATA`; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("CABLEJAX_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real scans not found: set CABLEJAX_DATA (looked in {folder})")
    return folder
