"""Digests of sources: what a result depends on, and what may change without changing it."""

import pytest

from experiments.harness.revision import code_revision, is_clean
from experiments.harness.sources import OUTSIDE, Sources, at_revision, combined, present

FILES = {
    "cablejax/__init__.py": "",
    "cablejax/ops/__init__.py": "from cablejax.ops.a import f\nfrom cablejax.ops.b import g\n",
    "cablejax/ops/a.py": 'from cablejax.io import read\ndef f(x):\n    """Twice."""\n    return 2 * x  # why\n',
    "cablejax/ops/b.py": "def g(x):\n    return 3 * x\n",
    "cablejax/io/__init__.py": "def read():\n    pass\n",
    "experiments/train.py": "import jax\nfrom cablejax.ops import f\ndef run():\n    return f(1)\n",
}


def digests(**changes: str) -> dict[str, str]:
    files = {**FILES, **{f"cablejax/ops/{name}.py": text for name, text in changes.items()}}
    return Sources(files.get).digests("experiments.train")


def test_a_name_is_followed_to_where_it_is_defined():
    assert list(digests()) == ["cablejax.ops.a", "experiments.train"]  # neither b, nor what reads files
    assert list(Sources(FILES.get).digests("experiments.train", without=("cablejax.ops",))) == ["experiments.train"]


@pytest.mark.parametrize(
    "text",
    [
        "from cablejax.io import read\ndef f(x):\n    return 2 * x\n",
        'from cablejax.io import read\n\n\ndef f(x):\n    """Another docstring."""\n    return (2 *\n        x)\n',
    ],
)
def test_comments_docstrings_and_formatting_do_not_count(text: str):
    assert digests(a=text) == digests()


@pytest.mark.parametrize(
    ("name", "text", "same"),
    [("a", FILES["cablejax/ops/a.py"].replace("2 * x", "3 * x"), False), ("b", "def g(x):\n    return 4 * x\n", True)],
)
def test_what_is_computed_counts(name: str, text: str, same: bool):
    assert (combined(digests(**{name: text})) == combined(digests())) == same


def test_no_such_module():
    with pytest.raises(ValueError, match=r"expected a module of cablejax or experiments, got experiments\.nothing"):
        Sources(FILES.get).digests("experiments.nothing")


def test_the_networks_training_depends_on_what_decides_it():
    found = present("experiments.train")
    for name in (
        "nets.adgcnn",
        "nets.separable",
        "ops.raster",
        "ops.edges",
        "simulate.clouds",
        "train.update",
        "train.fitting",
    ):
        assert f"cablejax.{name}" in found
    assert not any(name.startswith(("cablejax.io", "experiments.harness", "experiments.display")) for name in found)


@pytest.mark.parametrize("module", OUTSIDE)
def test_what_is_left_out_is_there(module: str):
    """A module that was renamed would else count to every result again."""
    assert Sources()._tree(module) is not None


def test_sources_of_a_commit():
    revision = code_revision()
    if revision.startswith("unversioned"):
        pytest.skip("no git checkout")
    then = Sources(at_revision(revision.split("+")[0])).digests("experiments.train")
    assert "cablejax.nets.adgcnn" in then
    assert not is_clean(revision) or then == present("experiments.train")
    with pytest.raises(ValueError, match="revision: expected a commit of this checkout, got nowhere"):
        at_revision("nowhere")
