"""Checkpoints: bit for bit, atomic, and honest about damage."""

import os
import resource
import signal
import subprocess
import sys
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.io import checkpoint_files, restore_checkpoint, save_checkpoint


class State(NamedTuple):
    """A small training state."""

    params: dict
    count: jax.Array
    key: jax.Array


def bits(leaf):
    """What must be equal: type, shape and bytes."""
    if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return str(leaf.dtype), leaf.shape, np.asarray(jax.random.key_data(leaf)).tobytes()
    if isinstance(leaf, jax.Array | np.ndarray | np.generic):
        return type(leaf).__name__, leaf.dtype, leaf.shape, np.asarray(leaf).tobytes()
    return type(leaf).__name__, repr(leaf)


def assert_same(tree, other):
    assert jax.tree_util.tree_structure(tree) == jax.tree_util.tree_structure(other)
    for a, b in zip(jax.tree_util.tree_leaves(tree), jax.tree_util.tree_leaves(other), strict=True):
        assert bits(a) == bits(b)


def example():
    odd = np.array([np.nan, -0.0, np.inf, 1e-45, 3.0], np.float32)
    odd.view(np.uint32)[0] |= 5  # a NaN with a payload
    return State(
        params={
            "w": jnp.asarray(odd),
            "b16": jnp.asarray([1.5, -0.0, 3e38], jnp.bfloat16),
            "f8": jnp.asarray([1.5, -2.0], jnp.float8_e4m3fn),
            "i4": jnp.asarray([-8, 7], jnp.int4),
            "empty": jnp.zeros((0, 3)),
            "flag": jnp.asarray([True, False]),
            "nested": {"host": np.arange(3, dtype=np.float64) / 3, "scalar": np.float32(0.1), "big": np.int64(2**62)},
        },
        count=jnp.asarray(2**31 - 1, jnp.int32),
        key=jax.random.split(jax.random.key(7), 2),
    )


def blank(tree):
    """The same tree with other values, as a freshly initialised program would have."""

    def other(leaf):
        if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return jax.random.split(jax.random.key(0), leaf.shape[0])
        return type(leaf)(0) if isinstance(leaf, np.generic) else (leaf * 0).astype(leaf.dtype)

    return jax.tree_util.tree_map(other, tree)


def test_restored_bit_for_bit(tmp_path):
    tree = example()
    save_checkpoint(tmp_path, 12, tree, meta={"config": {"lr": 1.0}})
    step, restored, meta = restore_checkpoint(tmp_path, blank(tree))
    assert (step, meta) == (12, {"config": {"lr": 1.0}})
    assert_same(restored, tree)
    assert np.array_equal(jax.random.normal(restored.key[1], (4,)), jax.random.normal(tree.key[1], (4,)))


@pytest.mark.parametrize("value", [True, -(2**80), 0.1, float("nan"), float("-inf"), "grün"])
def test_python_scalars_keep_type_and_value(tmp_path, value):
    save_checkpoint(tmp_path, 0, {"a": value})
    restored = restore_checkpoint(tmp_path, {"a": type(value)(0)}).tree["a"]
    assert type(restored) is type(value)
    assert repr(restored) == repr(value)


def test_weak_type_survives_and_nothing_retraces(tmp_path):
    traces = []

    @jax.jit
    def double(x):
        traces.append(x)
        return x * 2

    tree = {"a": jnp.asarray(1.5), "b": jnp.float32(1.5)}
    double(tree["a"]), double(tree["b"])
    save_checkpoint(tmp_path, 0, tree)
    restored = restore_checkpoint(tmp_path, tree).tree
    double(restored["a"]), double(restored["b"])
    assert len(traces) == 2


def test_nnx_state_and_rngs(tmp_path):
    def build(seed):
        rngs = nnx.Rngs(seed)
        return nnx.Sequential(nnx.Linear(3, 4, rngs=rngs), nnx.BatchNorm(4, rngs=rngs), nnx.Dropout(0.5, rngs=rngs))

    state = nnx.state(build(1))
    save_checkpoint(tmp_path, 3, state)
    restored = restore_checkpoint(tmp_path, nnx.state(build(2))).tree
    assert isinstance(restored, nnx.State)
    assert_same(restored, state)


@pytest.mark.parametrize(
    ("like", "words"),
    [
        (lambda: {"a": jnp.zeros(3)}, r"leaf \['a'\].*float32\[2\].*float32\[3\]"),
        (lambda: {"a": jnp.zeros(2, jnp.int32)}, r"leaf \['a'\].*float32\[2\].*int32\[2\]"),
        (lambda: {"a": 1.0}, r"leaf \['a'\].*array.*float"),
        (lambda: {"a": jax.random.split(jax.random.key(0))}, r"leaf \['a'\].*array.*key"),
        (lambda: {"b": jnp.zeros(2)}, r"lacks the leaves \[\"\['b'\]\"\].*besides \[\"\['a'\]\"\]"),
    ],
)
def test_a_tree_that_does_not_fit_is_refused(tmp_path, like, words):
    save_checkpoint(tmp_path, 0, {"a": jnp.zeros(2)})
    with pytest.raises(ValueError, match=words):
        restore_checkpoint(tmp_path, like())


def test_key_of_another_generator_is_refused(tmp_path):
    save_checkpoint(tmp_path, 0, {"key": jax.random.key(0)})
    with pytest.raises(ValueError, match=r"key<fry>.*key<rbg>"):
        restore_checkpoint(tmp_path, {"key": jax.random.key(0, impl="rbg")})


@pytest.mark.parametrize("leaf", [object(), np.array(["a"], object), b"bytes"])
def test_a_leaf_that_cannot_be_stored_is_named(tmp_path, leaf):
    with pytest.raises(ValueError, match=r"leaf \['x'\]"):
        save_checkpoint(tmp_path, 0, {"x": leaf})
    assert checkpoint_files(tmp_path) == []


@pytest.mark.parametrize(("step", "keep", "name"), [(-1, 3, "step"), (1, 0, "keep")])
def test_arguments_are_checked(tmp_path, step, keep, name):
    with pytest.raises(ValueError, match=name):
        save_checkpoint(tmp_path, step, {}, keep=keep)


def test_meta_must_be_json(tmp_path):
    with pytest.raises(ValueError, match="meta"):
        save_checkpoint(tmp_path, 0, {}, meta={"a": object()})


def test_the_last_few_are_kept(tmp_path):
    for step in (1, 2, 30, 4_000_000_000):
        save_checkpoint(tmp_path, step, {"a": step}, keep=2)
    assert [restored.name for restored in checkpoint_files(tmp_path)] == [
        "step_0000000030.ckpt",
        "step_4000000000.ckpt",
    ]
    assert restore_checkpoint(tmp_path, {"a": 0}).tree == {"a": 4_000_000_000}


def test_a_run_begun_anew_does_not_resume_from_the_old_one(tmp_path):
    for step in (10, 20, 1):
        save_checkpoint(tmp_path, step, {"a": step})
    assert restore_checkpoint(tmp_path, {"a": 0}).step == 1


def test_nothing_to_restore(tmp_path):
    assert restore_checkpoint(tmp_path, {}) is None
    assert restore_checkpoint(tmp_path / "absent", {}) is None


def test_any_damage_is_found_and_the_previous_one_taken(tmp_path):
    save_checkpoint(tmp_path, 1, {"a": jnp.arange(4)})
    path = save_checkpoint(tmp_path, 2, {"a": jnp.arange(4) + 1})
    whole = path.read_bytes()  # 22 bytes of magic, 8 of a length, the content, 32 of a digest
    damaged = [whole[:cut] for cut in range(0, len(whole), 7)]
    for at in range(0, len(whole), 5):
        damaged.append(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
    for content in [*damaged, whole + b"\0"]:
        path.write_bytes(content)
        words = "is truncated or no checkpoint" if len(content) < 62 or content[:22] != whole[:22] else "is damaged"
        with pytest.warns(UserWarning, match=rf"step_0000000002\.ckpt: {words}.*before it"):
            assert restore_checkpoint(tmp_path, {"a": jnp.zeros(4, jnp.int32)}).step == 1
    path.write_bytes(whole)
    assert restore_checkpoint(tmp_path, {"a": jnp.zeros(4, jnp.int32)}).step == 2


def test_a_full_disk_is_said_and_old_files_stay(tmp_path):
    save_checkpoint(tmp_path, 1, {"a": np.zeros(8)})
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    # No file may grow beyond 10 kB: writes fail as on a full disk, with EFBIG in place of ENOSPC.
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, old[1]))
    try:
        with pytest.raises(OSError, match="not enough space to write the file; nothing was changed"):
            save_checkpoint(tmp_path, 2, {"a": np.zeros(10_000)}, keep=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
    assert [path.name for path in tmp_path.iterdir()] == ["step_0000000001.ckpt"]
    assert restore_checkpoint(tmp_path, {"a": np.ones(8)}).step == 1


WRITER = """
import sys
import numpy as np
from cablejax.io import save_checkpoint
for step in range(10**6):
    save_checkpoint(sys.argv[1], step, {"a": np.full(200_000, step)})
    print(step, flush=True)
"""


def test_killed_at_any_moment_leaves_a_whole_checkpoint(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for _ in range(3):
        process.stdout.readline()
    time.sleep(0.05)
    process.kill()
    done = process.communicate()[0].split()
    step, tree, _ = restore_checkpoint(tmp_path, {"a": np.zeros(200_000, int)})
    assert step >= int(done[-1] if done else 2)
    assert np.all(tree["a"] == step)
    save_checkpoint(tmp_path, step + 1, tree)
    assert not list(tmp_path.glob(".*.part"))  # what the killed write left is swept up


SHARDED = """
import sys
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from cablejax.io import restore_checkpoint, save_checkpoint

mesh = jax.make_mesh((4,), ("data",))
split, everywhere = (NamedSharding(mesh, PartitionSpec(*axes)) for axes in (["data"], []))
tree = {"x": jax.device_put(jnp.arange(8.0), split), "key": jax.device_put(jax.random.key(3), everywhere)}
blank = {"x": jax.device_put(jnp.zeros(8), split), "key": jax.device_put(jax.random.key(0), everywhere)}
save_checkpoint(sys.argv[1], 1, tree)
back = restore_checkpoint(sys.argv[1], blank).tree
assert np.array_equal(back["x"], tree["x"])
assert np.array_equal(jax.random.key_data(back["key"]), jax.random.key_data(tree["key"]))
assert back["x"].sharding == split and len(back["x"].addressable_shards) == 4
assert len(back["key"].sharding.device_set) == 4
"""


def test_arrays_return_to_the_devices_they_were_split_over(tmp_path):
    flags = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"}
    subprocess.run([sys.executable, "-c", SHARDED, str(tmp_path)], env=flags, check=True)
