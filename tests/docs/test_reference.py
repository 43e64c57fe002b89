"""Every public name is on a page of the reference: the build checks the pages, this the list that they are made from."""

import ast
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from experiments import ROOT

INDEX = ROOT / "docs" / "reference" / "index.md"


@pytest.fixture(scope="module")
def names() -> ModuleType:
    """What the site's extension knows of public names."""
    spec = importlib.util.spec_from_file_location("names", ROOT / "docs" / "_ext" / "names.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def with_all(path: Path) -> bool:
    """Whether a package states what is public."""
    assigned = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.Assign)]
    return any(isinstance(name, ast.Name) and name.id == "__all__" for node in assigned for name in node.targets)


def test_every_package_that_states_what_is_public_is_listed():
    stated = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for path in (ROOT / "cablejax").rglob("__init__.py")
        if with_all(path)
    }
    listed = set(re.findall(r"^   (cablejax[\w.]*)$", INDEX.read_text(), flags=re.MULTILINE))
    assert listed == stated


def test_every_public_name_gets_a_page(names: ModuleType):
    paged = {
        f"{package}.{name}" for package, found in names.kinds().items() for kind in found if kind != "elsewhere"
        for name in found[kind]
    }  # fmt: skip
    for package, public in names.public_names().items():
        for name in public:
            assert names.home(package, name) in paged, f"{package}.{name}"


def test_inline_code_finds_its_page(names: ModuleType):
    short = names.short_names()
    assert short["knn"] == short["cablejax.ops.neighbors.knn"] == "cablejax.ops.knn"
    assert short["cablejax.ops"] == "cablejax.ops"
    assert "nominal_probabilities" not in short  # measure and simulate have one each
