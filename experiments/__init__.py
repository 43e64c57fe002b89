"""Hydra experiments: one module per kind of job, one file under conf/experiment/ per table and figure of the paper.

Importing this package points jax at a compilation cache beside the sources, so that the second run of a sweep compiles
nothing; it must therefore come before jax is first used.
"""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# XLA calls every program that it loads from the cache a possible mismatch, in kilobytes of text, because of tuning hints
# (prefer-no-gather) that no processor lists; 3 leaves fatal errors alone.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
