"""Candidate terms: parsing, generation and reduction.

* No text is evaluated. ``scanner.py`` checks the characters, and ``parser.py`` checks Python's syntax tree
  against a whitelist. An error is one line with the column and the cure, and takes milliseconds for any
  text. ``format_expression`` writes text that reads back as an equal expression.
* A ``Term`` is text, a SymPy expression over real symbols, and its kind (``term.py``). A ``Library`` is
  an ordered, immutable set of them (``library.py``), given as a list, read from a file (``collect.py``) or
  generated from the kinds of coordinates (``families.py``, with the table of families; ``chains.py``: chains
  of many links).
* ``Library.reduced()`` (``reduction.py``) drops terms that no data can distinguish: terms whose
  Euler–Lagrange expression is zero or a linear combination of others. This must hold in high precision (60
  digits; 400 beside many nearly collinear terms), so that a nearly collinear term always stays.
  ``Library.dropped`` gives the reasons.
* ``jets.py`` computes the derivatives for this: values and first and mixed second derivatives by the chain
  rule, in double or high precision, without symbolic differentiation. ``invariance.py`` derives from them the
  conditions of shifts, rotations and exchanges of coordinates on the coefficients.
* ``tree.py`` holds kinematic trees, which replace a library if the geometry is known (``geometry.py``).
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
