"""Treat equations as exact where the data do not contradict it.

Cost: five to ten steps of the joint fit. Without it, where an exact library is fitted, coefficients depend by
some tenths of a standard error on the path that the search took.
"""

from __future__ import annotations

from leastaction.estimation.exact_limit import towards_exact
from leastaction.selection.search_state import Search

__all__ = ["run"]


def run(search: Search) -> Search:
    """The same structure at the largest weights that are as likely."""
    return search.now(towards_exact(search.found))
