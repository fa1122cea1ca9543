"""Formulas as MathML, written into the pages when they are built: no script, no font, no network.

``html_math_renderer = "mathml"`` in conf.py. What latex2mathml cannot read is a warning, and so the build
fails.
"""

from __future__ import annotations

import re
from html import escape

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

# Names of functions need the space of an operator on both sides.
_FUNCTION = re.compile(r"<(m[io])[^>]*>(log|det|exp|sin|cos)</\1>")
_SPACED = r'<mo lspace="0.17em" rspace="0.17em" movablelimits="false">\2</mo>'
_log = logging.getLogger(__name__)


def _inline(writer: HTML5Translator, node: nodes.math) -> None:
    writer.body.append(_mathml(node, node.astext(), "inline"))
    raise nodes.SkipNode


def _display(writer: HTML5Translator, node: nodes.math_block) -> None:
    text = node.astext()
    if "\\\\" in text and "\\begin{" not in text:
        text = f"\\begin{{align*}}{text}\\end{{align*}}"
    label = f' id="equation-{node["label"]}"' if node.get("label") else ""
    # scrolls where it is wider than the page; then the keyboard must reach it
    writer.body.append(f'<div class="math-block" tabindex="0"{label}>{_mathml(node, text, "block")}</div>\n')
    raise nodes.SkipNode


def _mathml(node: nodes.Element, text: str, display: str) -> str:
    try:
        markup = _FUNCTION.sub(_SPACED, convert(text, display=display))
        # a command that it does not know comes through as it is
        trouble = "unknown command" if "\\" in markup or "&#x0005C;" in markup else ""
    except Exception as error:
        markup, trouble = f"<code>{escape(text)}</code>", repr(error)
    if trouble:
        _log.warning("formula %r: %s", text, trouble, location=node)
    return markup


def setup(app: Sphinx) -> dict[str, object]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
