"""Grow terms with unknown numbers where the grammar's plain terms do not explain the data.

Only for libraries that are grown from names (`Library.symbolic`): whoever offers candidates is told of a
family that would help, and decides.  A law with a family takes the place of the one that was found if its
equations hold and it is likelier by the evidence, less the price of its terms and of their numbers.

Cost: a profile of the weak form for each family, beside few candidates, and a search with each of the best.
A family takes the place of the candidates that may imitate it, since it has nothing to gain beside them.

* Where the equations hold: of the whole potential, if two of its terms go beyond the second degree or a mass
  depends on its own position, as imitations of exponentials and powers do; of all but springs, if three do.
* Where they do not: of all but springs, then distances to unknown points, which cost the most.  With one
  coordinate, families are then tried beside the law.

Skipped otherwise, and where a library has no description lengths.
Without it exponentials and distances to unknown points are not found from names alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain

from leastaction.selection.families import helpful_families, looks_imitated, replacing_families
from leastaction.selection.likelihood_refinement import value
from leastaction.selection.search_state import Search, equations_hold, explains
from leastaction.selection.settings import SELECTION
from leastaction.selection.strategies import finer_knots, shape_fit

__all__ = ["run"]

_MOST_SAMPLES = 50_000  # with more coordinates, locating points takes too long


def run(search: Search) -> Search:
    """The law with the family that explains the data best, or the search as it was."""
    fit = search.found
    if search.problem.lengths is None or fit.problem.trajectories.n_samples > _MOST_SAMPLES:
        return search
    explained = explains(fit, value(fit))
    if explained and not looks_imitated(fit, SELECTION.plain_terms_grown):
        return search
    search.report("families", {})
    holds = equations_hold(fit)
    ways: list[Callable[[Search], Iterator[Search]]] = []
    if holds:
        ways.append(partial(replacing_families, alone=True))
    if not explained or looks_imitated(fit):
        ways.append(replacing_families)
    if len(fit.problem.coordinates) == 1 and not holds:
        ways.append(helpful_families)
    for at in chain.from_iterable(way(search) for way in ways):
        if value(at.found) <= value(fit):
            continue
        found = shape_fit.run(finer_knots.run(at))
        if found.found.converged and equations_hold(found.found):
            return replace(found, report=search.report, first=search.first)
    return search
