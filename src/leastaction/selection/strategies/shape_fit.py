"""Fit the shape parameters together with curve and coefficients, and drop what they make needless.

A term that only made up for wrong numbers loses its worth when these are right.

Cost: three to six joint fits. Skipped where the structure holds no shape parameter.
"""

from __future__ import annotations

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.shapes import fit_shapes
from leastaction.selection.likelihood_refinement import penalty, refine, value
from leastaction.selection.search_state import Search

__all__ = ["run"]

_ROUNDS = 4  # at most, each with fits


def run(search: Search) -> Search:
    """The best structure with its shape parameters at their most likely numbers."""
    fit = search.found
    if not fit.problem.shapes_of(fit.structure) or not fit.usable:
        return search
    fit = fit_shapes(fit)
    for _ in range(_ROUNDS):
        better = _smaller(fit) or _other(fit, search)
        if better is None:
            break
        fit = better
    return search.now(fit).at(fit.problem.shape_values)


def _smaller(fit: Fit) -> Fit | None:
    """The fit without its weakest term, where that is better."""
    weakest = fit.structure.members[int(np.argmin(fit.z**2))]
    if len(fit.structure) < 2 or np.min(fit.z**2) > penalty(fit.grid):
        return None
    other = fit_shapes(fit.grid.fit(fit.structure.without([weakest]), fit.start))
    return other if value(other) > value(fit) else None


def _other(fit: Fit, search: Search) -> Fit | None:
    """Another structure that is better with these numbers, and with its own."""
    other = refine(fit, search.report, 2)
    if other.structure == fit.structure:
        return None
    other = fit_shapes(other)
    return other if value(other) > value(fit) else None
