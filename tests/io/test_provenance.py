"""Provenance says what ran, and nothing about whose machine it ran on."""

import dataclasses
import getpass
import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.io import git_state, jsonable, provenance, read_json, write_json


@dataclasses.dataclass
class Config:
    """A configuration with what must not leak."""

    scan: str
    rate: float = 0.1
    sizes: tuple = (25, 35)


class Pair(NamedTuple):
    """A result."""

    a: float
    b: int


def git(folder, *arguments):
    subprocess.run(["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", *arguments], check=True)


def test_no_path_user_or_host(tmp_path, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", f"--xla_dump_to={tmp_path} --xla_force_host_platform_device_count=2")
    config = Config(scan=str(tmp_path / "scan.ply"))
    record = provenance(seeds={"data": 1}, config={"run": config, "home": "~/x", "windows": r"C:\Users\me\scan.ply"})
    text = json.dumps(record)
    for secret in (
        str(tmp_path),
        str(Path.home()) + "/",
        socket.gethostname(),
        str(Path.cwd()),
        "Users",
        f"/{getpass.getuser()}",
    ):
        assert secret not in text
    assert record["config"]["run"] == {"scan": "scan.ply", "rate": 0.1, "sizes": [25, 35]}
    assert record["config"]["windows"] == "scan.ply"
    assert record["cpu"]["threads"]["XLA_FLAGS"] == "--xla_force_host_platform_device_count=2"


def test_versions_and_device_are_those_in_use():
    import jax
    import optax

    record = provenance(seeds=[0, 1, 2])
    assert record["seeds"] == [0, 1, 2]
    assert record["versions"]["jax"] == jax.__version__
    assert record["versions"]["optax"] == optax.__version__
    assert record["versions"]["numpy"] == np.__version__
    assert record["device"] == {"platform": "cpu", "kind": jax.devices()[0].device_kind, "count": jax.device_count()}
    assert record["python"] == ".".join(map(str, sys.version_info[:3]))


def test_open3d_is_not_imported():
    code = """
import sys
from cablejax.io import provenance
print(provenance(seeds=0)["versions"]["open3d"], "open3d" in sys.modules)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert out[0][0].isdigit()
    assert out[1] == "False"


def test_dirty_means_tracked_or_untracked_but_not_ignored(tmp_path):
    git(tmp_path, "init", "-q")
    (tmp_path / ".gitignore").write_text("runs/\n")
    (tmp_path / "a").write_text("1")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    clean = git_state(tmp_path)
    assert clean["dirty"] is False
    assert len(clean["revision"]) == 40
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "log").write_text("x")
    assert git_state(tmp_path) == clean
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "table.json").write_text("{}")
    assert git_state(tmp_path) == clean  # what a command writes makes its own next file no less clean
    (tmp_path / "new.py").write_text("x")
    assert git_state(tmp_path) == {**clean, "dirty": True}
    (tmp_path / "new.py").unlink()
    (tmp_path / "a").write_text("2")
    assert git_state(tmp_path) == {**clean, "dirty": True}
    # An installed package inside somebody else's checkout has no revision of its own.
    assert git_state(tmp_path / "runs") == {"revision": None, "dirty": None}


def test_json_round_trip(tmp_path):
    path = tmp_path / "a.json"
    write_json(
        path, {"array": jnp.arange(3), "nan": np.float32("nan"), "pair": Pair(1.5, 2), "set": {3, 1}, "none": None}
    )
    assert read_json(path) == {"array": [0, 1, 2], "nan": None, "pair": {"a": 1.5, "b": 2}, "set": [1, 3], "none": None}


def test_json_is_laid_out_for_reading(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"rows": [{"x": [1, 2.5], "empty": {}}], "matrix": [[1, 0], [0, 1]], "none": []})
    assert path.read_text() == (
        '{\n  "rows": [\n    {\n      "x": [1, 2.5],\n      "empty": {}\n    }\n  ],\n'
        '  "matrix": [[1, 0], [0, 1]],\n  "none": []\n}\n'
    )


def test_json_failures_leave_the_old_file(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, [1])
    with pytest.raises(ValueError, match="got object"):
        write_json(path, {"a": object()})
    assert read_json(path) == [1]
    path.write_text("{")
    with pytest.raises(ValueError, match=r"a\.json: expected JSON"):
        read_json(path)
    with pytest.raises(FileNotFoundError):
        write_json(tmp_path / "absent" / "a.json", 1)


@pytest.mark.parametrize("value", [0.1, 2**70, True, "a", [1.0, None]])
def test_plain_values_stay(value):
    assert jsonable(value) == value
