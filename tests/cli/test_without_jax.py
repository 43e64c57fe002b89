"""What needs no jax does not wait for it: its import alone takes a second or two, and half of the memory."""

import json
import subprocess
import sys

import pytest

from cablejax.io import write_points
from tests.reference.circles import bent_cable

MAIN = """
import sys
from cablejax.cli.main import main
code = main(sys.argv[1:])
print("jax" in sys.modules, file=sys.stderr)
raise SystemExit(code)
"""


@pytest.fixture
def scan(tmp_path):
    path = tmp_path / "scan.ply"
    write_points(path, bent_cable(radius=17.1, n=4000, arc_deg=360.0, noise=0.05, seed=2), unit="mm")
    return path


def run(*arguments):
    done = subprocess.run(
        [sys.executable, "-c", MAIN, *map(str, arguments)], capture_output=True, text=True, check=True
    )
    return done.stdout, done.stderr.splitlines()[-1]


def test_parts_without_kernels_do_not_import_it():
    parts = "io", "measure", "geometry", "export", "batch", "report", "cli"
    code = (
        "; ".join(f"import cablejax.{part}" for part in parts) + "; import sys; raise SystemExit('jax' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("command", ["measure", "info"])
def test_a_command_without_kernels(scan, command):
    out, jax = run(command, scan, "--unit", "mm", "--json", *(("--labels", "off") if command == "measure" else ()))
    assert jax == "False"
    if command == "measure":
        assert abs(json.loads(out)["diameter_mm"] - 34.2) < 0.2


def test_a_command_with_kernels_has_them_set_up(scan, tmp_path, monkeypatch):
    monkeypatch.setenv("CABLEJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    _, jax = run("denoise", scan, tmp_path / "out.ply", "--unit", "mm", "--no-filter", "--neighbors", "20")
    assert (jax, len(list((tmp_path / "cache").iterdir())) > 0) == ("True", True)
