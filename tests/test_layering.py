"""Imports point one way: types <- ops <- {registration, measure, simulate, nets} <- train; types <- {io, report}.

`geometry` stands below registration, measure and report. In experiments: harness <- material <- the commands, and
analysis <- display.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "cablejax"

ALLOWED = {
    "__main__": {"cli"},
    "__init__": {"types", "jax_sums", "programs"},
    "jax_sums": set(),
    "compiled": set(),
    "traces": {"compiled", "programs"},
    "optional": set(),
    "runtime": {"jax_sums", "compiled"},
    "types": {"jax_sums", "programs"},
    "programs": set(),
    "ops": {"types"},
    "geometry": set(),
    "registration": {"types", "ops", "geometry"},
    "measure": {"types", "ops", "geometry"},
    "simulate": {"types", "ops", "traces"},
    "nets": {"types", "ops"},
    "train": {"types", "ops", "geometry", "registration", "measure", "simulate", "nets", "io"},
    "io": {"types", "optional"},
    "report": {"types", "optional", "geometry"},
    "batch": {"types", "io", "optional", "runtime"},
    "export": {"types", "io", "geometry", "measure", "report", "optional"},
    "tiles": {"types", "ops", "io", "batch", "traces"},
    "app": {"io", "measure", "report", "export", "batch"},
    "cli": {
        "app",
        "types",
        "ops",
        "geometry",
        "registration",
        "measure",
        "simulate",
        "nets",
        "train",
        "io",
        "report",
        "tiles",
        "batch",
        "export",
    }
    | {"optional", "runtime", "jax_sums", "traces"},
}
EXPERIMENTS = {
    "harness": set(),
    "material": {"harness"},
    "analysis": {"material"},  # the names of the study's stages
    "display": {"analysis", "harness", "material"},
}
HEAVY = (
    "jax",
    "numpy",
    "open3d",
    "hydra",
    "omegaconf",
    "matplotlib",
    "plotly",
    "tensorboardX",
    "flax",
    "optax",
    "pye57",
    "laspy",
)


def part_of(module: str) -> str | None:
    """The part of cablejax that a dotted module name belongs to, None for other packages."""
    head, *rest = module.split(".")
    if head != "cablejax":
        return None
    return rest[0] if rest else "__init__"


def imports(path: Path) -> set[str]:
    """Every module that a file imports anywhere, functions included."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write it absolute"
            assert node.module is not None
            found.add(node.module)
            if node.module == "cablejax":
                found |= {f"cablejax.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path: Path):
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    for module in imports(path):
        assert not module.startswith(("experiments", "benchmarks", "tests")), f"{path} imports {module}"
        part = part_of(module)
        # Importing any part runs the package's __init__, so everybody imports that.
        if (
            part not in (None, "__init__")
            and part != own
            and (PACKAGE / part).exists() | (PACKAGE / f"{part}.py").exists()
        ):
            assert part in ALLOWED[own], f"cablejax.{own} must not import cablejax.{part} ({path})"


def _experiments_of(path: Path) -> set[str]:
    """The parts of experiments that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module == "experiments":
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None and node.module.startswith("experiments."):
            found.add(node.module.split(".")[1])
    return found - {"ROOT"}


@pytest.mark.parametrize("part", EXPERIMENTS)
def test_experiments_build_on_their_folders_one_way(part: str):
    paths = sorted((PACKAGE.parent / "experiments" / part).rglob("*.py"))
    assert len(paths) > 3
    for path in paths:
        assert _experiments_of(path) <= EXPERIMENTS[part] | {part}, path


def test_ops_needs_jax_alone():
    for path in (PACKAGE / "ops").glob("*.py"):
        roots = {module.split(".")[0] for module in imports(path)} - set(sys.stdlib_module_names)
        assert roots <= {"jax", "jaxtyping", "cablejax", "numpy"}, f"{path}: {roots}"


def test_import_is_light():
    code = f"import sys, cablejax; print([m for m in {HEAVY!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
