"""Begin: structures proposed by the weak form, refined on the likelihood.

Cost: one weak form for each test-function width, and a joint fit for each structure that is refined. Skipped
where the starts of shape parameters were compared by such fits.
"""

from __future__ import annotations

from leastaction.selection.likelihood_refinement import best_structure
from leastaction.selection.search_state import Search
from leastaction.selection.weak_proposals import propose_structures

__all__ = ["run"]


def run(search: Search) -> Search:
    """The best structure on the first grid."""
    if search.fit is not None:
        return search
    proposals = propose_structures(search.grid, search.curve, search.report, search.seed)
    fit = best_structure(proposals, None, search.report)
    return search.now(fit, first=fit)
