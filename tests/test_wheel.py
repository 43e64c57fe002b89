"""The wheel in environments that hold what it asks for and nothing else: the core alone, and the core with `scan`.

An environment is a venv into which the wheel is installed, and the packages of its requirements and theirs are linked from
the one that runs the tests: no network, and a package that nothing asks for is not there.
"""

import importlib.metadata
import json
import os
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from cablejax.jax_sums import FLAG

ROOT = Path(__file__).resolve().parents[1]
KERNELS = """
import warnings
import cablejax
cablejax.ensure_right_sums()
import numpy as np
from cablejax import PointCloud
from cablejax.ops import knn, statistical_outliers
xyz = np.stack([np.arange(40.0), np.zeros(40), np.zeros(40)], axis=1)
xyz[7, 2] = 30.0
cloud = PointCloud.from_xyz(xyz, capacity=64)
found = knn(cloud.xyz, k=2, mask=cloud.mask)
assert found.neighbors[20].tolist() == [19, 21] and found.sq_dist[20].tolist() == [1.0, 1.0]
assert not statistical_outliers(cloud, k=4).keep[7]
import cablejax.io, cablejax.measure, cablejax.nets, cablejax.registration, cablejax.report, cablejax.simulate
import cablejax.tiles, cablejax.train
"""

BY_TURNS = """
import json, sys
from cablejax.cli import main
codes = [main([*command, "--quiet"]) for command in json.loads(sys.argv[1])]
print("codes", codes)
"""


def closure(*extras: str) -> set[str]:
    """Distributions that the wheel needs with these extras, itself left out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = project["dependencies"] + [line for extra in extras for line in project["optional-dependencies"][extra]]
    open_, found = wanted(lines, set()), set()
    while open_:
        requirement = open_.pop()
        if requirement.name not in found:
            found.add(requirement.name)
            open_ += wanted(importlib.metadata.requires(requirement.name) or [], requirement.extras)
    return found


def wanted(lines: list[str], extras: set[str]) -> list[Requirement]:
    """The requirements that hold on this machine with these extras of the package that has them."""
    asked = [Requirement(line) for line in lines]
    return [one for one in asked if one.marker is None or any(one.marker.evaluate({"extra": e}) for e in extras | {""})]


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the sources without network."""
    folder = tmp_path_factory.mktemp("wheel")
    sources = folder / "sources"  # a copy: building leaves folders behind
    shutil.copytree(ROOT / "cablejax", sources / "cablejax", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, sources)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--quiet",
        "-w",
        folder,
        sources,
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (path,) = folder.glob("cablejax-*.whl")
    return path


def environment(folder: Path, wheel: Path, *extras: str) -> Path:
    """A venv with the wheel and what it asks for; its `bin`."""
    venv.create(folder, symlinks=True)
    (site,) = folder.glob("lib/python*/site-packages")
    command = [sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--no-deps", "--quiet"]
    done = subprocess.run([*command, "--no-index", wheel], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in closure(*extras):
        distribution = importlib.metadata.distribution(name)
        for top in {file.parts[0] for file in distribution.files or []} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(distribution.locate_file(top))))
    return folder / "bin"


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command in an environment of its own: no PYTHONPATH that could lend it anything, and not the flag for right sums."""
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    clean["XLA_FLAGS"] = " ".join(flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(FLAG))
    return subprocess.run(command, env=clean, cwd=cwd, capture_output=True, text=True)


def succeed(*command: str | Path, cwd: Path) -> str:
    done = run(*command, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def by_turns(bin_: Path, *commands: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Commands in one process, which tells their exit codes last."""
    return run(bin_ / "python", "-I", "-c", BY_TURNS, json.dumps([line.split() for line in commands]), cwd=cwd)


def test_what_the_wheel_holds(wheel: Path):
    with zipfile.ZipFile(wheel) as file:
        held = set(file.namelist())
        (metadata,) = [name for name in held if name.endswith("METADATA")]
        text = file.read(metadata).decode()
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "cablejax").rglob("*") if path.is_file()}
    assert {name for name in sources if "__pycache__" not in name} <= held
    assert "cablejax/py.typed" in held
    assert "cablejax/nets/weights/adgcnn_fit.npz" in held
    assert not [name for name in held if not name.startswith(("cablejax/", "cablejax-"))]
    assert "Project-URL: " in text


def test_the_core_alone(wheel: Path, tmp_path: Path):
    bin_ = environment(tmp_path / "core", wheel)
    succeed(bin_ / "python", "-I", "-W", "error::UserWarning", "-c", KERNELS, cwd=tmp_path)
    assert (
        succeed(bin_ / "cablejax", "--version", cwd=tmp_path) == f"cablejax {importlib.metadata.version('cablejax')}\n"
    )
    done = by_turns(
        bin_,
        "simulate scan.ply --points 1800",
        "measure scan.ply --unit mm",
        "classify scan.ply --unit mm",
        "simulate scan.las --points 1800",
        "measure scan.ply --unit mm --report r.html",
        cwd=tmp_path,
    )
    assert "codes [0, 0, 0, 1, 1]" in done.stdout, done.stderr
    assert "diameter" in done.stdout
    assert "mm2, by adgcnn" in done.stdout
    said = done.stderr.splitlines()
    assert len(said) == 2
    assert all("cablejax[scan]" in line for line in said)


def test_with_scan(wheel: Path, tmp_path: Path):
    bin_ = environment(tmp_path / "scan", wheel, "scan")
    done = by_turns(
        bin_,
        "simulate s.laz --points 1800 --picture s.png",
        "denoise s.laz clean.ply --neighbors 20 --unit mm",
        "measure clean.ply --report r.html --unit mm",
        cwd=tmp_path,
    )
    assert "codes [0, 0, 0]" in done.stdout, done.stderr
    assert "diameter" in done.stdout
    assert (tmp_path / "r.html").stat().st_size > 1_000_000  # plotly is inside: the page needs no network
