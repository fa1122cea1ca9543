"""Where the equations do not hold, search again, also from kinetic seeds.

Cost: that of the first search, on the first grid. Skipped where the equations hold, where finer knots
followed vibrations, and where the data themselves are in doubt.
Without it (`docs/ablations.md`) nothing fails on 27 set-ups that it was not made for.
"""

from __future__ import annotations

from dataclasses import replace

from leastaction.estimation.grid import Grid
from leastaction.selection.likelihood_refinement import best_structure, value
from leastaction.selection.search_state import Search, explains
from leastaction.selection.strategies import finer_knots
from leastaction.selection.weak_proposals import propose_structures

__all__ = ["run"]


def run(search: Search) -> Search:
    """The better of the present structure and that of a second search."""
    fit, before = search.found, search.first
    search = replace(search, first=None)  # not used afterwards
    if not search.thorough or search.vibrates or explains(fit, value(fit)):
        return search
    first = Grid.lay(fit.problem, search.scales.per_second)
    proposals = propose_structures(first, search.curve, search.report, search.seed + 1, thorough=True)
    # compared on the grid of the first search, where both were found
    other = best_structure(proposals, before, search.report)
    return search if other is before else finer_knots.run(search.now(other))
