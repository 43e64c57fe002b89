"""Queries over eight devices, in a process of its own: the number of devices is fixed when jax starts."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import build_tree, query_sharded

PROGRAM = """
import jax, jax.numpy as jnp, numpy as np
from cablejax.ops import build_tree, query, query_sharded

mesh = jax.make_mesh((4, 2), ("a", "b"))
rng = np.random.default_rng(0)

def check(n, q, k, box=None):
    xyz = rng.integers(0, 9, size=(n, 3)).astype(np.float32)  # ties and duplicates, more than k of some
    xyz[5] = np.nan
    tree = build_tree(jnp.asarray(xyz), mask=jnp.arange(n) % 7 > 0, box=box)
    for queries in (None, jnp.asarray(rng.random((q, 3)) * 9, dtype=jnp.float32)):
        together, apart = query(tree, queries, k=k), query_sharded(tree, queries, k=k, mesh=mesh)
        for one, other in zip(together, apart, strict=True):
            np.testing.assert_array_equal(one, other)

check(100, 9, 4)
check(100, 16, 120)
check(100, 9, 4, jnp.full(3, 9.0))
check(2500, 333, 7)
xyz = jnp.asarray(rng.random((50, 3)), dtype=jnp.float32)
cost = lambda ask: lambda x: jnp.sum(jnp.sin(ask(build_tree(x)).sq_dist))
one = jax.grad(cost(lambda tree: query(tree, k=3)))(xyz)
other = jax.grad(cost(lambda tree: query_sharded(tree, k=3, mesh=mesh)))(xyz)
np.testing.assert_allclose(one, other, atol=1e-6)
print(jax.device_count(), "devices agree")
"""


def test_eight_devices_find_what_one_finds():
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**os.environ, "XLA_FLAGS": flags}, capture_output=True, text=True
    )
    assert run.stdout == "8 devices agree\n", run.stderr[-3000:]


def test_a_ragged_batch_is_refused():
    mesh = jax.make_mesh((1,), ("x",))
    tree = build_tree(jnp.zeros((4, 3)), row_splits=jnp.array([0, 2, 4]))
    with pytest.raises(ValueError, match="tree: expected one of one cloud, got one of a ragged batch"):
        query_sharded(tree, k=1, mesh=mesh)


def test_one_device_serves_too():
    mesh = jax.make_mesh((1,), ("x",))
    found = query_sharded(build_tree(jnp.arange(5.0)[:, None]), k=1, mesh=mesh)
    np.testing.assert_array_equal(found.neighbors[:, 0], [1, 0, 1, 2, 3])
