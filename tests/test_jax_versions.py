"""jax from 0.10.2 on computes wrong numbers on the CPU: it is excluded, and what it gets wrong is tested for."""

import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
from packaging.requirements import Requirement

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
BROKEN = ("0.10.2", "0.11.0", "0.11.1", "0.11.2", "0.12.0.1")  # 0.11.0 crashes and 0.11.1 breaks flax besides


def test_vmapped_matrix_vector_product_then_sum():
    # jax 0.10.2, 0.11.2 and 0.12.0.1 give 131076 under jit, a quarter of it. The terms are 4 and their sum stays
    # below 2^24, so float32 is exact in any order.
    rows = 32_769
    matrix = jnp.ones((4, 4))
    vectors = jnp.ones((rows, 4))

    def total(v: jax.Array) -> jax.Array:
        return jax.vmap(lambda row: matrix @ row)(v).sum()

    assert float(jax.jit(total)(vectors)) == 16 * rows
    assert float(total(vectors)) == 16 * rows


def test_broken_versions_are_excluded():
    dependencies = tomllib.loads(PYPROJECT.read_text())["project"]["dependencies"]
    (requirement,) = [line for line in dependencies if line.startswith("jax>")]
    allowed = Requirement(requirement).specifier
    assert not [version for version in BROKEN if version in allowed]
    assert jax.__version__ in allowed


def test_locks_name_no_registry():
    for lock in (PYPROJECT.parent / "requirements").glob("*.txt"):
        text = lock.read_text()
        assert "http" not in text
        assert "index-url" not in text
        assert "--hash=sha256:" in text
