"""A search begun anew, with common terms and friction beside the candidates, where these explain nothing.

Tests on the final fit (`_lacking`, `_hidden`) add a little to a structure that is nearly right.  A structure
that is far from the law is no start for that: the search begins from the data again.
"""

from __future__ import annotations

import numpy as np

from leastaction._fit.workspace import Workspace
from leastaction._hidden import say_friction, usual_friction
from leastaction._lacking import common_terms, say_lacking
from leastaction._refinement import equations_hold, silent
from leastaction._selection import Refiner, best_structure, propose_supports
from leastaction._smoothing import smooth

__all__ = ["search_afresh"]

_MOST_SAMPLES = 50_000  # a search on more takes too long for a hint


def search_afresh(workspace: Workspace) -> list[str]:
    """Say which common terms, and which friction, lead to equations that hold; nothing if none do."""
    smooth_friction = [
        t for t in usual_friction(workspace.columns) if not t.text.startswith("abs") or "**" in t.text
    ]
    more = [*common_terms(workspace.columns, "standard"), *smooth_friction]
    if not more or workspace.trajectories.n_samples > _MOST_SAMPLES:
        return []
    wider = workspace.changed(np.append(workspace.known, np.full(len(more), np.nan)), more)
    refiner = Refiner(wider, silent)
    curve = smooth(wider.grid, wider.times, wider.values, rates=wider.rates)
    found, _ = refiner.dissipate(best_structure(refiner, propose_supports(wider, curve, silent), None))
    if not (found.fit.converged and equations_hold(wider, found)):
        return []
    new = [m for m in found.members if m >= len(workspace.columns)]
    terms = [wider.columns.terms[m].text for m in new if wider.columns.terms[m].kind == "lagrangian"]
    out = [say_lacking(terms, f"{len(found.members)} free terms explain the motion")] if terms else []
    return out + [
        say_friction(wider.columns.terms[m], f"coefficient about {found.coefficients[m]:.2g}")
        for m in new
        if wider.columns.terms[m].kind == "dissipation"
    ]
