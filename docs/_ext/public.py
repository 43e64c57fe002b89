"""Sphinx extension: every public name on a page of the reference, and links to them from inline code.

The reference is made from the list of packages in docs/reference/index.md (autosummary takes the names from `__all__`); after
reading, every public name must be the target of some page, or the build says which is not. Inline code that is a public name,
alone (`knn`) where only one package has it or in full (`cablejax.ops.knn`), becomes a link, so that pages stay plain Markdown.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from docutils import nodes
from names import PACKAGE, flat, home, homes, kinds, packages, short_names
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging

ARRAY = re.compile(r"\b(?:jaxlib\._jax|jax|numpy)\.(Array|ndarray)\b")
COMPUTED = re.compile(r"<[\w ][^<>]*>")
FIELDS = re.compile(r"^ {4}\w+(?:, \w+)+: ")
KEPT: dict[str, list[str]] = {}
logger = logging.getLogger(__name__)


class LinkInlineCode(SphinxPostTransform):
    """Inline code that names something public, as `knn` or `cablejax.ops.knn()`, links to its page."""

    default_priority = 5

    def run(self, **_: Any) -> None:
        for literal in list(self.document.findall(nodes.literal)):
            target = short_names().get(literal.astext().removesuffix("()"))
            inside = isinstance(literal.parent, (nodes.reference, pending_xref, nodes.title))
            if target is None or inside or target.rpartition(".")[2] == self.env.docname.rpartition(".")[2]:
                continue
            link = pending_xref(
                "", refdomain="py", reftype="obj", reftarget=target, refexplicit=True, refdoc=self.env.docname
            )
            literal.replace_self(link)
            link += literal


def public_reference(app: Sphinx, env: BuildEnvironment, node: pending_xref, contnode: nodes.Node) -> nodes.Node | None:
    """Resolve a type by where it is defined to the page of the public name."""
    if node.get("refdomain") != "py":
        return None
    target = homes().get(node["reftarget"])
    if target is None:
        return None
    return env.domains.python_domain.resolve_xref(
        env,
        node["refdoc"],
        app.builder,
        "obj",
        target,
        node,
        contnode,  # pyright: ignore[reportArgumentType]
    )


def check_public_names(_: Sphinx, env: BuildEnvironment) -> None:
    """Warn of every public name without a page; warnings fail the build."""
    documented = set(env.domains.python_domain.objects)
    for package, name in flat():
        if home(package, name) not in documented:
            logger.warning("%s.%s is public (in __all__) and on no page of the reference", package, name, type="public")


def skip_fields(_: Sphinx, __: str, ___: str, item: Any, skip: bool, ____: Any) -> bool | None:
    """Leave out fields of named tuples, which their class's docstring describes."""
    return True if str(getattr(item, "__doc__", "")).startswith("Alias for field number") else None


def describe_constants(_: Sphinx, __: str, name: str, item: Any, ___: Any, lines: list[str]) -> None:
    """Say of a constant what it holds; the docstring that it has is its type's."""
    package, _dot, bare = name.rpartition(".")
    if bare not in kinds().get(package, {}).get("Constants", ()):
        return
    if isinstance(item, (Mapping, tuple, frozenset)) and all(isinstance(each, str) for each in item):
        lines[:] = [f"Names: {', '.join(f'``{each}``' for each in item)}."]
    else:
        lines[:] = [f"``{item}``"]


def prepare_docstring(_: Sphinx, what: str, name: str, __: Any, ___: Any, lines: list[str]) -> None:
    """Before napoleon reads it: `a, b: text` is one field of two names; a property's sentence is kept as it is."""
    lines[:] = [FIELDS.sub(lambda match: match[0].replace(", ", ","), line) for line in lines]
    if what == "property":
        KEPT[name] = list(lines)


def restore_property(_: Sphinx, __: str, name: str, ___: Any, ____: Any, lines: list[str]) -> None:
    """After napoleon, which takes what stands before the first colon of a property's docstring for its type."""
    if name in KEPT:
        lines[:] = KEPT.pop(name)


def shorten_arrays(
    _: Sphinx, __: str, ___: str, ____: Any, _____: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Write `Float[Array, 'n 3']` as the source does, without the modules of the array types, and computed defaults as `...`."""
    short = [None if each is None else COMPUTED.sub("...", ARRAY.sub(r"\1", each)) for each in (signature, returned)]
    return short[0], short[1]


def remove_stale(app: Sphinx) -> None:
    """Remove pages of names that are public no more, which autosummary leaves behind."""
    wanted = {*packages(), *(home(package, name) for package, name in flat())}
    for path in (Path(app.srcdir) / "reference").glob(f"{PACKAGE}*.rst"):
        if path.stem not in wanted:
            path.unlink()


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("builder-inited", remove_stale, priority=100)  # autosummary writes its pages at 500
    app.add_post_transform(LinkInlineCode)
    app.connect("missing-reference", public_reference)
    app.connect("env-check-consistency", check_public_names)
    app.connect("autodoc-skip-member", skip_fields)
    app.connect("autodoc-process-signature", shorten_arrays)
    app.connect("autodoc-process-docstring", prepare_docstring, priority=100)  # napoleon reads at 500
    app.connect("autodoc-process-docstring", restore_property, priority=900)
    app.connect("autodoc-process-docstring", describe_constants)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
