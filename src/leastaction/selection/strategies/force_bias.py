"""Slowly changing forces beside the known ones, found together with the terms: the bias of an actuator.

Least squares along the curve of a first fit gives the forces; they join the known ones and the terms are
searched again, until nothing changes.  At the end curve, coefficients and forces are fitted together, so that
the standard errors know that the forces are not known.

Cost: up to four more searches. Skipped where no such force is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from leastaction.estimation.force_bias import fit_with_forces
from leastaction.estimation.grid import Grid
from leastaction.estimation.weights import Start
from leastaction.selection.likelihood_refinement import penalty
from leastaction.selection.search_state import Search, restarted

__all__ = ["run"]

_MOST_FITS = 12  # alternations between curve, terms and forces


def run(search: Search, again: Callable[[Search], Search]) -> Search:
    """Alternate a search for terms and a fit of the forces; ``again`` is the search."""
    if not search.bias.seconds:
        return again(search)
    found = again(replace(search, thorough=False))
    while not found.stopped and (bias := found.bias.followed(found.found)) is not None:
        search.report("drift", bias.size)
        grid = Grid.lay(search.problem.with_forces(bias.forces), search.scales.per_second)
        found = again(replace(restarted(search, grid, search.scales.smooth), bias=bias))
    return found if found.stopped else _settled(found)


def _settled(search: Search) -> Search:
    """Fit terms and slow forces together, without the terms that are then no longer significant."""
    fit, bias, grid = search.found, search.bias, search.found.grid
    if not fit.converged:
        return search
    structure, start = fit.structure, fit.start
    for _ in range(_MOST_FITS):
        joint, more, errors = fit_with_forces(grid, structure, start, bias.seconds)
        if not joint.converged:
            return search
        bias = bias.adding(more, errors)
        grid = grid.pushed(bias.forces)
        n = len(structure)
        covariance = joint.covariance[:n, :n]
        z = joint.coefficients[:n] / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        _, index = grid.physics(structure)
        coefficients = np.zeros_like(start.coefficients)
        coefficients[index] = joint.coefficients[: len(index)]
        settled = bias.settled(more)
        if settled and n > 1 and np.min(z**2) < penalty(grid):
            # fitted next with the forces, which the term may have replaced
            structure = structure.without([structure.members[int(np.argmin(z**2))]])
            start = Start(fit.control_points, coefficients, fit.weights)
            continue
        fit = grid.fit(structure, Start(joint.control_points, coefficients, fit.weights))
        start = fit.start
        if settled:
            fit = replace(fit, covariance=covariance)
            break
    return replace(search.now(fit), bias=bias)
