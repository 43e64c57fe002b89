"""Sphinx extension: formulas as MathML, which browsers draw themselves: no script, no network, any theme."""

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

TAG = re.compile(r"\\tag\{([^}]*)\}")


def inline(writer: Any, node: nodes.math) -> None:
    """A formula within a line."""
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """A formula on a line of its own, with its number at the side."""
    text = node.astext()
    tag = TAG.search(text)
    number = f'<span class="equation-number">({tag[1]})</span>' if tag else ""
    formula = convert(TAG.sub("", text).strip(), display="block")
    identity = f' id="equation-{tag[1]}"' if tag else ""
    writer.body.append(f'<div class="equation"{identity}>{formula}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
