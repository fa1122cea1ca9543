"""Equations of motion of the law, and correlations of its coefficients."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy as sp
from markupsafe import Markup

from leastaction.errors import InputError
from leastaction.identifiers import names_in_terms
from leastaction.library import format_expression, make_term, time_symbol
from leastaction.mechanics.equations import state_symbols
from leastaction.model.mathml import Notation
from leastaction.model.model import LagrangianModel
from leastaction.model.term import ModelTerm
from leastaction.report.text import signed

__all__ = ["contributions", "correlations", "equations"]

_MOST_TERMS = 30  # of a law whose equations are shown
_MOST_COLUMNS = 8  # of the table of correlations
_MOST_PAIRS = 10
_WEAK = 0.3  # correlations below this are left out if only some are listed


def equations(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """d/dt ∂L/∂q̇ − ∂L/∂q + ∂ψ/∂q̇ of each coordinate that is not prescribed, addend by addend.

    Each number is the coefficient of a term of L or ψ times a constant, with its standard error. Empty if the
    law is too long for a page.
    """
    both = [*((t, True) for t in model.terms), *((t, False) for t in model.dissipation)]
    if len(both) > _MOST_TERMS:
        return []
    out = []
    for i, name in enumerate(model.coordinates):
        if name in model.prescribed:
            continue
        addends: list[Markup] = []
        for term, of_lagrangian in both:
            for part in contributions(term, of_lagrangian, model.coordinates, i):
                number, rest = part.as_coeff_Mul()
                try:
                    text = format_expression(rest)
                except InputError:  # signs and other functions outside the grammar
                    return []
                size, error = float(number) * term.coefficient, abs(float(number)) * term.standard_error
                addends.append(notation.addend(text, size, error, "", not addends))
        out.append({"symbol": notation.heading(name), "addends": addends})
    return out


def contributions(
    term: ModelTerm, of_lagrangian: bool, coordinates: tuple[str, ...], i: int
) -> Sequence[sp.Expr]:
    """Addends of a term with the coefficient 1 in the i-th equation, accelerations first."""
    expr = make_term(term.expression, names_in_terms(coordinates)).expr
    q, qdot, qddot = state_symbols(coordinates)
    total = slope = sp.diff(expr, qdot[i])
    if of_lagrangian:
        total = sp.diff(slope, time_symbol) - sp.diff(expr, q[i])
        for k in range(len(coordinates)):
            total += sp.diff(slope, q[k]) * qdot[k] + sp.diff(slope, qdot[k]) * qddot[k]
    parts = sp.Add.make_args(sp.expand(total))
    return [p for p in sorted(parts, key=lambda p: not p.has(*qddot)) if p != 0]


def correlations(model: LagrangianModel, notation: Notation) -> dict[str, Any]:
    """Correlation coefficients of the estimates: a table if it fits, otherwise the strongest pairs.

    Empty with fewer than two estimates, or without a covariance.
    """
    free = [t for t in (*model.terms, *model.dissipation) if not t.known]
    names = [t.written for t in free] + [f"{{{shape.name}}}" for shape in model.shapes]
    if model.covariance is None or len(names) < 2 or len(model.covariance) != len(names):
        return {}
    size = np.sqrt(np.diag(model.covariance))
    with np.errstate(all="ignore"):
        matrix = model.covariance / np.outer(size, size)
    if not np.isfinite(matrix).all():
        return {}
    rows, columns = np.triu_indices(len(names), 1)
    ranked = np.argsort(-np.abs(matrix[rows, columns]), kind="stable")
    pairs = [
        {
            "one": notation.term(names[rows[k]]),
            "other": notation.term(names[columns[k]]),
            "value": signed(float(matrix[rows[k], columns[k]]), 2),
        }
        for k in ranked[:_MOST_PAIRS]
        if k == ranked[0] or abs(matrix[rows[k], columns[k]]) >= _WEAK
    ]
    table = [
        {
            "term": notation.term(name),
            "cells": [signed(float(matrix[j, k]), 2) if k < j else "" for k in range(len(names) - 1)],
        }
        for j, name in enumerate(names)
        if j
    ]
    small = len(names) <= _MOST_COLUMNS
    return {
        "strongest": pairs[0],
        "size": math.fabs(float(matrix[rows[ranked[0]], columns[ranked[0]]])),
        "columns": [notation.term(name) for name in names[:-1]] if small else [],
        "table": table if small else [],
        "pairs": pairs,
    }
