"""jax sums wrongly on the CPU from 0.10.2 on: the flag that mends it is set where it is needed, and the sum is checked."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlib.version
import pytest
from packaging.requirements import Requirement

from cablejax import ensure_right_sums, jax_sums

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
BROKEN = ("0.11.0", "0.11.1")  # 0.11.0 crashes and 0.11.1 breaks flax, flag or no flag
AFFECTED = jaxlib.version.__version__ in jax_sums.NEEDING_FLAG
PARTS = "cablejax.io, cablejax.measure, cablejax.nets, cablejax.ops, cablejax.simulate, cablejax.train"


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the package from these sources and no flag that the tests set."""
    clean = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=clean | environment, cwd=PYPROJECT.parent, capture_output=True, text=True)


def test_vmapped_matrix_vector_product_then_sum():
    # Without the flag jax 0.10.2, 0.11.2 and 0.12.0.1 give 131076 under jit, a quarter of it. The terms are 4 and their
    # sum stays below 2^24, so float32 is exact in any order.
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
    assert all(version in allowed for version in jax_sums.NEEDING_FLAG)
    assert jax.__version__ in allowed


@pytest.mark.parametrize("before", [None, "", "--xla_cpu_max_isa=AVX2"])
@pytest.mark.parametrize("version", ["0.10.1", "0.12.0.1", "0.99.0"])
def test_the_flag_is_set_for_known_releases_alone(monkeypatch, version, before):
    monkeypatch.setattr(jax_sums.jaxlib_version, "__version__", version)
    monkeypatch.setattr(jax_sums, "_backend_started", lambda: False)
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    if before is not None:
        monkeypatch.setenv("XLA_FLAGS", before)
    for _ in range(2):  # the second call adds nothing
        jax_sums.set_flag()
    if version == "0.12.0.1":
        assert os.environ["XLA_FLAGS"].split() == [*(before or "").split(), jax_sums.FLAG]
    else:
        assert os.environ.get("XLA_FLAGS") == before


def test_a_flag_given_by_hand_stays(monkeypatch):
    monkeypatch.setattr(jax_sums.jaxlib_version, "__version__", "0.12.0.1")
    monkeypatch.setattr(jax_sums, "_backend_started", lambda: False)
    monkeypatch.setenv("XLA_FLAGS", f"{jax_sums.FLAG}individual_dot")
    jax_sums.set_flag()
    assert os.environ["XLA_FLAGS"] == f"{jax_sums.FLAG}individual_dot"


def test_the_flag_comes_too_late_for_a_running_backend(monkeypatch):
    jax.devices()  # XLA has read its flags by now
    monkeypatch.setattr(jax_sums.jaxlib_version, "__version__", "0.12.0.1")
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    jax_sums.set_flag()
    assert "XLA_FLAGS" not in os.environ
    with pytest.warns(
        UserWarning, match=r"0\.12\.0\.1 sums wrongly .*call cablejax\.ensure_right_sums\(\) .* or set XLA_FLAGS="
    ):
        jax_sums.warn_where_wrong()


def test_a_wrong_sum_is_an_error_with_its_remedy(monkeypatch):
    ensure_right_sums()
    jax_sums.check_sums.cache_clear()
    monkeypatch.setattr(jax, "jit", lambda function: lambda rows: function(jnp.asarray(rows)) / 4)
    with pytest.raises(jax_sums.WrongSumsError, match=r"sums to 16388 what is 65552: set XLA_FLAGS=\S+ .*install jax"):
        ensure_right_sums()


@pytest.mark.skipif(not AFFECTED, reason="this release of jax sums rightly without the flag")
def test_without_the_flag_a_library_user_is_warned_and_can_mend_it():
    assert "sums wrongly" in run("import cablejax.ops").stderr
    assert run("import cablejax.jax_sums as s; s.check_sums()").stderr.count("WrongSumsError: jax") == 1
    mended = run("import cablejax; cablejax.ensure_right_sums(); import cablejax.ops")
    assert (mended.returncode, mended.stderr) == (0, "")


def test_importing_changes_no_setting():
    # TF_CPP_MIN_LOG_LEVEL is set by jax itself, which is therefore imported first.
    code = f"""
import os, warnings, jax
before = dict(os.environ), dict(jax.config.values)
warnings.simplefilter("ignore")
import cablejax, {PARTS}
assert (dict(os.environ), {{name: jax.config.values[name] for name in before[1]}}) == before  # flax adds a name
assert not jax._src.xla_bridge.backends_are_initialized()
"""
    done = run(code)
    assert done.returncode == 0, done.stderr


def test_locks_name_no_registry():
    for lock in (PYPROJECT.parent / "requirements").glob("*.txt"):
        text = lock.read_text()
        assert "://" not in text
        assert "index-url" not in text
        assert "--hash=sha256:" in text
