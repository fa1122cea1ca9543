"""A search begun anew, with common terms and friction where the candidates do not explain the data.

Tests on the final fit (`missing_terms`, `friction`) add a little to a structure that is nearly right.  One
that is far from the law is no start for that, and imitates what is missing: the search begins from the data
again.
"""

from __future__ import annotations

import numpy as np
import sympy as sp

from leastaction.curve.smoothing import smooth
from leastaction.diagnosis.friction import unmodelled_friction, usual_friction
from leastaction.diagnosis.missing_terms import common_terms, missing_term
from leastaction.estimation.workspace import Workspace
from leastaction.findings import Finding
from leastaction.selection.knots import equations_hold, silent
from leastaction.selection.select import Refiner, best_structure, propose_supports

__all__ = ["search_afresh"]

_CERTAIN = 20.0  # standard errors: laws have 170 and more, what imitates them has terms of 4 to 8
_MOST_SAMPLES = 50_000  # a search on more takes too long for a hint


def search_afresh(workspace: Workspace) -> list[Finding]:
    """Say which common terms, and which friction, lead to equations that hold; nothing if none do."""
    # dry friction has a kink, which a curve meets only where it is smoothed
    friction = [term for term in usual_friction(workspace.columns) if not isinstance(term.expr, sp.Abs)]
    more = [*common_terms(workspace.columns, "standard"), *friction]
    if not more or workspace.trajectories.n_samples > _MOST_SAMPLES:
        return []
    wider = workspace.wider(more)
    refiner = Refiner(wider, silent)
    curve = smooth(wider.grid, wider.times, wider.values, rates=wider.rates)
    found, _ = refiner.dissipate(best_structure(refiner, propose_supports(wider, curve, silent), None))
    if not (found.fit.converged and equations_hold(wider, found)):
        return []
    if np.any(np.abs(found.estimates) < _CERTAIN * found.standard_errors):
        return []
    new = [m for m in found.members if m >= len(workspace.columns)]
    terms = [wider.columns.terms[m].text for m in new if wider.columns.terms[m].kind == "lagrangian"]
    free = len(found.members)
    out = [missing_term(terms, workspace.columns.coordinates, free_terms=free)] if terms else []
    return out + [
        unmodelled_friction(wider.columns.terms[m], coefficient=float(found.coefficients[m]))
        for m in new
        if wider.columns.terms[m].kind == "dissipation"
    ]
