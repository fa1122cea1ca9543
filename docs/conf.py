"""Settings of Sphinx. ``make docs`` builds the pages; they open from disk, without a network."""

from __future__ import annotations

import re
import sys
from html import escape
from importlib import metadata
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

_HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(_HERE / "_ext"))

project = "leastaction"
author = "leastaction developers"
copyright = author
try:
    release = version = metadata.version("leastaction")
except metadata.PackageNotFoundError:
    release = version = "unknown"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "generated_pages",
]
exclude_patterns = ["_build", "_ext", "gallery/*.ipynb", "gallery/*.md5"]
suppress_warnings = ["config.cache"]  # the gallery's settings hold a class, which cannot be pickled

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "smartquotes"]
myst_heading_anchors = 3

autosummary_generate = True
autosummary_imported_members = True
autodoc_typehints = "none"  # the docstrings say types and shapes
autodoc_member_order = "bysource"
add_module_names = False
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
# `name` in a docstring is a link where there is something of that name, and code where there is not.
default_role = "py:obj"
nitpick_ignore_regex = [("py:obj", r".*")]

html_theme = "pydata_sphinx_theme"
html_title = "leastaction"
html_static_path = ["_static"]
html_css_files = ["leastaction.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": True,
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_context = {"default_mode": "auto"}
html_sidebars = {"*": [], "reproduction/*": [], "api/*": ["sidebar-nav-bs"], "gallery/*": ["sidebar-nav-bs"]}
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "generated_pages.Sequence",
    "abort_on_example_error": True,
    "only_warn_on_example_error": False,
    "capture_repr": (),
    "image_srcset": ["2x"],
    "thumbnail_size": (480, 336),
    "doc_module": ("leastaction",),
    "backreferences_dir": "gallery/backreferences",
    "show_signature": False,
    # its table of times would fetch a script from another host
    "write_computation_times": False,
    "download_all_examples": True,
    "min_reported_time": 1,
    "reset_argv": lambda *_: [],
}


# ------------- formulas as MathML, written into the pages when they are built: no script, no font, no network
# What latex2mathml cannot read is a warning, and so the build fails.

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


def setup(app: Sphinx) -> None:
    """Register the renderer of formulas."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
