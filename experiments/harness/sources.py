"""Which sources a result depends on, and digests of them that comments, docstrings and formatting leave alone."""

import ast
import hashlib
import io
import subprocess
import tarfile
from collections.abc import Callable, Iterator
from functools import cache

from experiments import ROOT

OURS = ("cablejax", "experiments")
# What is logged, kept, checked and shown, none of which changes a number. A run's configuration is told by its own digest.
OUTSIDE = (
    "cablejax.io",
    "cablejax.jax_sums",
    "cablejax.optional",
    "cablejax.programs",
    "cablejax.train.memory",
    "cablejax.train.tensorboard_views",
    "cablejax.train.resume",
    "experiments.harness",
)

Reader = Callable[[str], str | None]  # a path below the root to its text, None where there is none


def on_disk(path: str) -> str | None:
    """A source of this checkout."""
    file = ROOT / path
    return file.read_text() if file.is_file() else None


def at_revision(revision: str) -> Reader:
    """The sources of a commit.

    Raises:
        ValueError: If this checkout does not know it.
    """
    done = subprocess.run(["git", "-C", str(ROOT), "archive", revision, *OURS], capture_output=True, check=False)
    if done.returncode:
        raise ValueError(f"revision: expected a commit of this checkout, got {revision}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        found = {
            each.name: archive.extractfile(each) for each in archive if each.isfile() and each.name.endswith(".py")
        }
        texts = {name: file.read().decode() for name, file in found.items() if file is not None}
    return texts.get


class Sources:
    """The modules of a checkout.

    Args:
        read: Where its files come from: this checkout, or a revision of it.
    """

    def __init__(self, read: Reader = on_disk):
        self.read = read
        self.trees: dict[str, ast.Module | None] = {}

    def digests(self, entry: str, *, without: tuple[str, ...] = ()) -> dict[str, str]:
        """Of every module that one imports the names of, itself included, directly or through others.

        A name that a package hands on is followed to where it is defined: a package that hands on much does not make a
        result depend on all of it.

        Args:
            entry: Its dotted name.
            without: Modules and packages that the result is known not to use.

        Raises:
            ValueError: If there is no such module.
        """
        found: dict[str, str] = {}
        left = [entry]
        while left:
            module = left.pop()
            if module in found or module in OURS or _within(module, OUTSIDE + without):
                continue
            tree = self._tree(module)
            if tree is None:
                raise ValueError(f"entry: expected a module of {' or '.join(OURS)}, got {module}")
            found[module] = hashlib.sha256(repr(_plain(tree)).encode()).hexdigest()[:8]
            left += self._imported(tree)
        return dict(sorted(found.items()))

    def _imported(self, tree: ast.Module) -> Iterator[str]:
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names if _ours(alias.name))
            elif isinstance(node, ast.ImportFrom) and node.module is not None and _ours(node.module):
                for alias in node.names:
                    yield self._home(node.module, alias.name)

    def _home(self, module: str, name: str) -> str:
        """The module that defines what another one hands on."""
        if self._tree(f"{module}.{name}") is not None:
            return f"{module}.{name}"
        tree = self._tree(module)
        for node in [] if tree is None else tree.body:
            if isinstance(node, ast.ImportFrom) and node.module is not None and _ours(node.module):
                for alias in node.names:
                    if (alias.asname or alias.name) == name:
                        return self._home(node.module, alias.name)
        return module

    def _tree(self, module: str) -> ast.Module | None:
        if module not in self.trees:
            base = module.replace(".", "/")
            text = self.read(f"{base}.py")
            text = self.read(f"{base}/__init__.py") if text is None else text
            self.trees[module] = None if text is None else ast.parse(text)
        return self.trees[module]


def combined(digests: dict[str, str]) -> str:
    """One digest of many."""
    return hashlib.sha256(repr(sorted(digests.items())).encode()).hexdigest()[:12]


@cache
def present(entry: str, without: tuple[str, ...] = ()) -> dict[str, str]:
    """The digests of what a module of this checkout depends on, as they are when first asked for; see `Sources.digests`."""
    return Sources().digests(entry, without=without)


def _ours(module: str) -> bool:
    return module.split(".")[0] in OURS


def _within(module: str, packages: tuple[str, ...]) -> bool:
    return any(module == each or module.startswith(f"{each}.") for each in packages)


def _plain(node: object) -> object:
    """A syntax tree as tuples, without docstrings and places; the same in every version of Python."""
    if isinstance(node, list):
        return [_plain(each) for each in node]
    if not isinstance(node, ast.AST):
        return node
    fields = {name: value for name, value in ast.iter_fields(node) if value not in (None, [])}
    if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(node):
        fields["body"] = fields["body"][1:]
    return type(node).__name__, [(name, _plain(value)) for name, value in fields.items()]
