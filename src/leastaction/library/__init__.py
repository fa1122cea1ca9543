"""Candidate terms: safe expression parser, generated families, null and duplicate analysis."""

from __future__ import annotations

from leastaction.library.library import Library
from leastaction.library.parser import format_expression, parse_expression
from leastaction.library.term import Dropped, Kind, Term, make_term, smooth_abs

__all__ = [
    "Dropped",
    "Kind",
    "Library",
    "Term",
    "format_expression",
    "make_term",
    "parse_expression",
    "smooth_abs",
]
