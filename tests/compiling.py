"""Compile for speed within a test that computes much; the others compile as cheaply as can be (see conftest.py)."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import jax

VARIABLE = "JAX_DISABLE_MOST_OPTIMIZATIONS"


@contextmanager
def compiled_for_speed() -> Iterator[None]:
    """Level 1 instead of 0 for what is compiled inside, also in child processes."""
    option, variable = jax.config.read("jax_disable_most_optimizations"), os.environ.pop(VARIABLE, None)
    jax.config.update("jax_disable_most_optimizations", False)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", option)
        if variable is not None:
            os.environ[VARIABLE] = variable
