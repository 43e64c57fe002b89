"""Shared test set-up: a compilation cache beside the sources, strict ranks, and the real data's folder."""

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

from cablejax.jax_sums import set_flag

set_flag()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scans, `$CABLEJAX_DATA`; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("CABLEJAX_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real scans not found: set CABLEJAX_DATA (looked in {folder})")
    return folder
