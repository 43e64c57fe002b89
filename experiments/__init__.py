"""Hydra experiments: one module per kind of job, one file under conf/experiment/ per table and figure of the paper.

Importing this package sets jax up (`cablejax.runtime`): right sums, and a cache of compiled programs, so that the second
run of a sweep compiles nothing. It must therefore come before jax first computes.
"""

from pathlib import Path

from cablejax.optional import require
from cablejax.runtime import set_up_jax

ROOT = Path(__file__).resolve().parents[1]

require("hydra", "omegaconf", "tensorboardX", "matplotlib", "plotly", "jinja2", why="an experiment")
set_up_jax()
