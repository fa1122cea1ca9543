"""Drop terms that hardly lower the equation error.

On real hardware the library is never exact, and with enough data every candidate becomes significant because
it mimics a little of what is missing.  A term has to lower the variance of the equation error by the share
``relevance``; for an exact library there is no equation error (``slack`` vanishes) and nothing is asked
beyond significance.

Cost: a quadratic model and a fit for each round of dropping.
Without it (`docs/ablations.md`) one of seven wrong set-ups has a wrong structure, but one of nine machines is
exact.
"""

from __future__ import annotations

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.selection.likelihood_refinement import Neighbourhood, penalty, refine, tell
from leastaction.selection.likelihood_search import QuadraticModel, search_subsets
from leastaction.selection.search_state import Search, equations_exact

__all__ = ["best_part", "price_of_terms", "refined", "run"]


def price_of_terms(fit: Fit, relevance: float) -> float:
    """What a term must lower −2 log likelihood by: its price, and its share of the equation error."""
    return penalty(fit.grid) + fit.relevant_gain(relevance)


def refined(search: Search, rounds: int) -> Search:
    """The better structures of `refine`, if they are better without their irrelevant terms, too.

    Where the equations do not hold exactly, nearly every candidate is significant. About a fit with many of
    them, the quadratic model may not lead back to the law.
    """
    fit = search.found
    again = refine(fit, search.report, rounds)
    exact = equations_exact(fit)
    if again.structure == fit.structure or exact or not fit.converged:
        return search.now(again)
    before, after = (run(search.now(one)).found for one in (fit, again))
    more = len(after.structure) - len(before.structure)
    dearer = 0.5 * price_of_terms(before, search.relevance) * more
    better = after.converged and after.evidence - dearer > before.evidence
    return search.now(again if better else before)


def best_part(model: QuadraticModel, price: float) -> tuple[int, ...]:
    """The support of the lowest cost that a local search finds, with a price for each member; not empty."""
    levels = search_subsets(model, tuple(range(model.n)), price)
    choices = [choice for level in levels.values() for choice in level if choice.members]
    return min(choices, key=lambda choice: choice.criterion(price)).members


def run(search: Search) -> Search:
    """The best structure among the terms of the fit on the quadratic model, its fit, and so on.

    Friction alone is no law.  Dropped one by one, terms that imitate a law together may outlast its own.
    """
    fit, problem = search.found, search.found.problem
    of_l = {k for k, term in enumerate(problem.terms) if term.kind == "lagrangian"}
    while fit.converged and len(fit.structure) > 1:
        near = Neighbourhood.of(fit)
        here = near.here
        kept = best_part(near.model.among(here), price_of_terms(fit, search.relevance))
        members = tuple(here[n] for n in kept)
        if members == here or not of_l & {*members, *np.flatnonzero(problem.is_known)}:
            break
        fit = fit.grid.fit(near.structure(members), near.start(members))
        tell(fit, search.report)
    return search.now(fit)
