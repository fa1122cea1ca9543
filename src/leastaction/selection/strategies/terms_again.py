"""Better structures on the final knots: a grid that was too coarse keeps terms that imitate its error.

Cost: one quadratic model, and a fit for each better structure that it proposes; where the equations do not
hold exactly, twice that of `irrelevant_terms`.
Without it (`docs/ablations.md`) one of nine further systems is wrong, a Morse molecule with a large library.
"""

from __future__ import annotations

from leastaction.selection.search_state import Search
from leastaction.selection.strategies import finer_knots, irrelevant_terms

__all__ = ["run"]

_ROUNDS = 4  # at most, each with fits


def run(search: Search) -> Search:
    """Refine the structure where it stands, and its knots if it changed."""
    again = irrelevant_terms.refined(search, _ROUNDS)
    return again if again.found.structure <= search.found.structure else finer_knots.run(again)
