"""Candidate terms: text goes in, trustworthy candidate terms come out.

* No text is ever evaluated. ``scanner.py`` looks at the characters, ``parser.py`` walks Python's syntax
  tree against a white list; every refusal is one line with the column and the cure, and takes
  milliseconds, whatever the text. ``format_expression`` writes text that reads back as an equal
  expression.
* A ``Term`` is text, a SymPy expression over real symbols, and its kind (``term.py``). A ``Library`` is
  an ordered, immutable set of them (``library.py``), given as a list, read from a file (``collect.py``) or
  generated from the kinds of coordinates (``families.py``: the table of families stands there;
  ``chains.py``: chains of many links).
* ``Library.reduced()`` (``reduction.py``) leaves out what the data could never tell apart: terms whose
  Euler–Lagrange expression is zero or a sum of those of others. A term is only dropped when that holds in
  high precision (60 digits; 400 beside many nearly collinear terms), so a term that is merely hard to
  tell apart always stays. ``Library.dropped`` says why each one went.
* ``jets.py`` holds the derivatives behind that: values and first and mixed second derivatives by the
  chain rule, in double or high precision, without symbolic differentiation. ``invariance.py`` asks with
  them what shifts, turns and exchanges of coordinates demand of the coefficients.
* ``tree.py`` holds kinematic trees, which stand for a library where the geometry is known (``geometry.py``);
  ``urdf.py`` and ``mjcf.py`` read them from files.

Imports from outside this folder: ``errors``, ``identifiers`` and the reading of files.
"""

from __future__ import annotations

from leastaction.library.friction import has_direction
from leastaction.library.library import Library
from leastaction.library.parser import (
    format_expression,
    is_constant,
    parse_expression,
    shape_symbol,
    time_symbol,
)
from leastaction.library.shapes import alike, exchanges, shape_names, tangent
from leastaction.library.term import Dropped, Kind, Template, Term, make_term, smooth_abs

__all__ = [
    "Dropped",
    "Kind",
    "Library",
    "Template",
    "Term",
    "alike",
    "exchanges",
    "format_expression",
    "has_direction",
    "is_constant",
    "make_term",
    "parse_expression",
    "shape_names",
    "shape_symbol",
    "smooth_abs",
    "tangent",
    "time_symbol",
]
