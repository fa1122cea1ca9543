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

from leastaction.estimation.fit import Fit
from leastaction.selection.likelihood_refinement import Neighbourhood, penalty, tell
from leastaction.selection.search_state import Search

__all__ = ["price_of_terms", "run"]


def price_of_terms(fit: Fit, relevance: float) -> float:
    """What a term must lower −2 log likelihood by: its price, and its share of the equation error."""
    return penalty(fit.grid) + fit.relevant_gain(relevance)


def run(search: Search) -> Search:
    """Drop terms one by one on the quadratic model, refit, and repeat."""
    fit = search.found
    while fit.converged and len(fit.structure) > 1:
        threshold = price_of_terms(fit, search.relevance)
        near = Neighbourhood.of(fit)
        members = near.here
        cost = near.model.best({members}, 1)[0].cost
        while len(members) > 1:
            smaller = near.model.best({tuple(m for m in members if m != out) for out in members}, 1)[0]
            if smaller.cost - cost > threshold:
                break
            members, cost = smaller.members, smaller.cost
        if members == near.here:
            break
        fit = fit.grid.fit(near.structure(members), near.start(members))
        tell(fit, search.report)
    return search.now(fit)
