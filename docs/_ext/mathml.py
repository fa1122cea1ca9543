"""Formulas as MathML, written into the pages when they are built: no script, no font, no network.

Docutils has a converter from LaTeX to MathML; this makes it a renderer of Sphinx
(``html_math_renderer = "mathml"``). What the converter cannot read is a warning, and so ends the build.
"""

from __future__ import annotations

from docutils import nodes
from docutils.utils.math import MathError, wrap_math_code
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

_log = logging.getLogger(__name__)


def _inline(writer: HTML5Translator, node: nodes.math) -> None:
    writer.body.append(_convert(node, node.astext(), block=False))
    raise nodes.SkipNode


def _display(writer: HTML5Translator, node: nodes.math_block) -> None:
    text = node.astext()
    if "&" in text or "\\\\" in text:
        text = wrap_math_code(text, as_block=True)
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    label = f' id="equation-{node["label"]}"' if node.get("label") else ""
    writer.body.append(
        f'<div class="math-block" tabindex="0"{label}>{_convert(node, text, block=True)}{number}</div>\n'
    )
    raise nodes.SkipNode


def _convert(node: nodes.Element, text: str, *, block: bool) -> str:
    try:
        return tex2mathml(text, as_block=block)
    except (MathError, SyntaxError) as error:
        _log.warning("formula %r: %s", text, error, location=node)
        return f"<code>{nodes.Text(text).astext()}</code>"


def setup(app: Sphinx) -> dict[str, object]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
