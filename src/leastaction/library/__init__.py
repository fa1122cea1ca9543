"""Candidate terms: safe expression parser, generated families, null and duplicate analysis."""

from __future__ import annotations

from leastaction.library.library import Library
from leastaction.library.parser import format_expression, is_constant, parse_expression, shape_symbol
from leastaction.library.shapes import shape_names, tangent
from leastaction.library.term import Dropped, Kind, Template, Term, make_term, smooth_abs

__all__ = [
    "Dropped",
    "Kind",
    "Library",
    "Template",
    "Term",
    "format_expression",
    "is_constant",
    "make_term",
    "parse_expression",
    "shape_names",
    "shape_symbol",
    "smooth_abs",
    "tangent",
]
