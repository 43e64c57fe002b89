"""What lacks a package says in one sentence which extra brings it."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from cablejax import optional
from cablejax.cli import main

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MODULES = {
    "tensorboardx": "tensorboardX",
    "hydra-core": "hydra",
    "open3d-cpu": "open3d",
    "libusb-package": "libusb_package",
}
BROUGHT_ALONG = {
    "matplotlib": "cycler",
    "hydra": "omegaconf",
    "jinja2": "markupsafe",
}  # what comes with a package of an extra
STANDS_ALONE = {"child.py"}  # runs without cablejax, in a process of its own, and words the sentence itself


def names(requirements: list[str]) -> set[str]:
    """What requirements are imported as."""
    found = {Requirement(line).name.lower() for line in requirements}
    found = {MODULES.get(name, name) for name in found} - {"cablejax"}
    return found | {BROUGHT_ALONG[name] for name in found & set(BROUGHT_ALONG)}


def at_run_time(tree: ast.AST) -> list[str]:
    """Packages that a file imports outside `if TYPE_CHECKING`."""
    found = []
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            found += [alias.name.split(".")[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.append(node.module.split(".")[0])
        found += at_run_time(node)
    return found


def required(tree: ast.AST) -> set[str]:
    """Packages that a file asks `require` for."""
    calls = [
        node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "require"
    ]
    return {argument.value for call in calls for argument in call.args if isinstance(argument, ast.Constant)}


@pytest.mark.parametrize("path", sorted((ROOT / "cablejax").rglob("*.py")), ids=lambda p: p.name)
def test_each_file_asks_for_the_optional_packages_that_it_imports(path: Path):
    tree = ast.parse(path.read_text())
    optionals = {name for name in at_run_time(tree) if name in optional.EXTRAS}
    core = names(PROJECT["dependencies"]) | {"jax", "jaxlib", "cablejax", "numpy", "yaml"}
    others = {name for name in at_run_time(tree) if name not in sys.stdlib_module_names | core}
    assert others <= set(optional.EXTRAS), f"{path}: in no extra"
    handles_it = any(
        isinstance(node, ast.ExceptHandler) and "ImportError" in ast.unparse(node) for node in ast.walk(tree)
    )
    if path.name not in STANDS_ALONE and not handles_it:
        assert optionals <= required(tree), f"{path}: require({optionals - required(tree)}) before the import"


@pytest.mark.parametrize(("package", "extra"), optional.EXTRAS.items())
def test_the_extra_named_brings_the_package(package: str, extra: str):
    assert package in names(PROJECT["optional-dependencies"][extra])


def test_the_sentence_names_what_is_missing(monkeypatch):
    optional.require("json", why="nothing")
    real = optional.importlib.util.find_spec
    missing = ("laspy", "hydra", "omegaconf")
    monkeypatch.setattr(optional.importlib.util, "find_spec", lambda name: None if name in missing else real(name))
    with pytest.raises(
        ImportError, match=re.escape('a study needs laspy and hydra: pip install "cablejax[scan,study]"')
    ):
        optional.require("json", "laspy", "hydra", why="a study")


@pytest.mark.parametrize(
    "arguments", [["simulate", "s.ply", "--picture", "s.png"], ["measure", "s.ply", "--report", "r.html"]]
)
def test_the_command_line_says_it_in_one_line_before_the_work(monkeypatch, tmp_path, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    real = optional.importlib.util.find_spec
    monkeypatch.setattr(
        optional.importlib.util, "find_spec", lambda name: None if name in optional.EXTRAS else real(name)
    )
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert 'pip install "cablejax[scan]"' in error
    assert list(tmp_path.iterdir()) == []
