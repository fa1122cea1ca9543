"""A search begun anew, with common terms and friction where the candidates do not explain the data.

Tests on the final fit (`missing_terms`, `friction`) add a little to a structure that is nearly right.  One
that is far from the law is no start for that, and imitates what is missing: the search begins from the data
again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import sympy as sp

from leastaction.curve.smoothing import Smooth
from leastaction.diagnosis.friction import unmodelled_friction, usual_friction
from leastaction.diagnosis.missing_terms import common_terms, missing_term
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.findings import Finding
from leastaction.selection.families import searched_with
from leastaction.selection.progress import silent
from leastaction.selection.search_state import Search, equations_hold, restarted
from leastaction.selection.strategies import feeding_friction, weak_start

__all__ = ["MOST_SAMPLES", "begun_anew", "search_afresh"]

MOST_SAMPLES = 50_000  # a search on more takes too long for a hint


def begun_anew(search: Search, grid: Grid, curve: Smooth | None = None) -> Fit | None:
    """What is found on a grid of all data, if its equations hold and every term is certain."""
    begun = restarted(replace(search, report=silent), grid, curve)
    found = searched_with(begun, weak_start, feeding_friction).found
    if not (found.converged and equations_hold(found)):
        return None
    certain = np.abs(found.estimates) >= DIAGNOSIS.certain * found.standard_errors
    return found if np.all(certain) else None


def search_afresh(search: Search) -> list[Finding]:
    """Say which common terms, and which friction, lead to equations that hold; nothing if none do."""
    fit = search.found
    # dry friction has a kink, which a curve meets only where it is smoothed
    friction = [term for term in usual_friction(fit.problem.candidates) if not isinstance(term.expr, sp.Abs)]
    more = [*common_terms(fit.problem.candidates, "standard"), *friction]
    if not more:
        return []
    found = begun_anew(search, fit.grid.posed(fit.problem.wider(more)))
    if found is None:
        return []
    new = [m for m in found.structure if m >= len(fit.problem.candidates)]
    terms = [found.problem.terms[m].text for m in new if found.problem.terms[m].kind == "lagrangian"]
    free = len(found.structure)
    out = [missing_term(terms, fit.problem.candidates.coordinates, free_terms=free)] if terms else []
    return out + [
        unmodelled_friction(found.problem.terms[m], coefficient=float(found.coefficients[m]))
        for m in new
        if found.problem.terms[m].kind == "dissipation"
    ]
