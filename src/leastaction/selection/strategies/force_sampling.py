"""What fast forces do between their samples, where coordinates follow them.

A search begins with band-limited forces if coordinates seem to follow forces of few samples a period
(:func:`leastaction.estimation.forces.fast_forces_act`).  The structure that it finds is fitted with a
straight line between samples, with the last sample held, and without the fast part, too: a controller that
feeds back what it measures puts the noise of the coordinates into the forces, and they seem to follow.  Where
another kind is likelier, the search is made again.

Cost: three fits, skipped where coordinates do not follow fast forces; a second search where they were taken
for what they are not.
Without it the Silverbox benchmark (nine samples a period) comes out with two thirds of its mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.forces import Between
from leastaction.estimation.grid import Grid
from leastaction.findings import find
from leastaction.selection.search_state import Search
from leastaction.selection.significance import chi_square_cutoff

__all__ = ["run"]

_OTHERS: tuple[Between, ...] = ("slow", "linear", "held")


def run(search: Search, again: Callable[[Search], Search]) -> Search:
    """The search with the likeliest forces between samples; ``again`` searches."""
    begun = search.problem.between
    if begun == "slow" or not search.found.converged:
        return search
    search.report("forces", {})
    fit = search.found
    found: dict[Between, float] = {begun: _likelihood(fit)}
    for between in _OTHERS:
        found[between] = _likelihood(fit.grid.acting(between).fit(fit.structure, fit.start))
    best = max(found, key=found.__getitem__)
    if found[best] - found[begun] > 0.5 * chi_square_cutoff(1, len(_OTHERS)):
        search = again(_acting(search, best))
    now = search.problem.between
    note = (find("fast-forces", between=now),) if now != "slow" else ()
    return replace(search, findings=(*search.findings, *note))


def _likelihood(fit: Fit) -> float:
    """Evidence of the measured coordinates, forces given; −∞ for a fit that failed.

    Where the scatter of the forces is known, `Fit.evidence` is that of coordinates and forces together.
    """
    if not fit.converged or not np.isfinite(fit.evidence):
        return -np.inf
    at, weights = fit.linearisation, fit.weights
    return fit.evidence + at.mean(weights.slack - weights.volume) * at.log_volume


def _acting(search: Search, between: Between) -> Search:
    """The search before it found anything, with other forces between samples."""
    new = search.posed(lambda problem: replace(problem, between=between))
    grid = Grid.lay(new.searched, new.scales.per_second)
    return replace(new, grid=grid, curve=new.scales.smooth, fit=None, first=None, feeding=())
