"""Begin: structures proposed by the weak form, refined on the likelihood.

Cost: one weak form for each test-function width, and a joint fit for each structure that is refined. Skipped
where the starts of shape parameters were compared by such fits.
"""

from __future__ import annotations

from collections.abc import Sequence

from leastaction.selection.likelihood_refinement import best_structure
from leastaction.selection.search_state import Search
from leastaction.selection.weak_proposals import Proposal, propose_structures

__all__ = ["proposals", "refined", "run"]


def run(search: Search) -> Search:
    """The best structure on the first grid."""
    return search if search.fit is not None else refined(search, proposals(search))


def proposals(search: Search) -> list[Proposal]:
    """Structures with starts, the best first."""
    return propose_structures(search.grid, search.curve, search.report, search.seed)


def refined(search: Search, some: Sequence[Proposal]) -> Search:
    """The best structure that some proposals lead to."""
    fit = best_structure(some, None, search.report)
    return search.now(fit, first=fit)
