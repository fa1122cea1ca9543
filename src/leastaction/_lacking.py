"""Does the library lack a term?  Common ones that are not among the candidates are tried on the final fit.

Where a needed term is missing others imitate it, along these data well enough to leave hardly any equation
error.  With the term itself fewer do, and the likelihood, less the price of the terms, is higher.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from leastaction._euler_lagrange import EulerLagrange
from leastaction._fit.evidence import Start
from leastaction._fit.workspace import StructureFit, Workspace
from leastaction._library import Library, Term
from leastaction._refinement import equations_hold, silent
from leastaction._selection import Refiner, Selection, best_structure, propose_supports
from leastaction._smoothing import smooth

__all__ = ["lacking_terms", "searched_terms"]

_BETTER = 10.0  # −2 log likelihood, beyond the price of every term
_MOST_TOGETHER = 3  # coordinates; of more, functions of several are left out, there are hundreds of them
_MOST_SAMPLES = 50_000  # a search on more takes too long for a hint
_ROUNDS = 3  # a term that is lacking is found in the first
_RELEVANT = 0.05  # share of the equation error's variance, as in the selection


def lacking_terms(workspace: Workspace, selection: Selection) -> list[str]:
    """Say which common terms would explain the motion better than the candidates do."""
    if not selection.structure.fit.converged:
        return []
    hold = equations_hold(workspace, selection.structure)
    found = _with_common(workspace, selection.structure, hold, "compact")
    if not found and not hold:
        found = _with_common(workspace, selection.structure, hold, "standard")
    return found


def _with_common(workspace: Workspace, structure: StructureFit, hold: bool, size: str) -> list[str]:
    columns = workspace.columns
    common = _not_offered(columns, size)
    if not common:
        return []
    wider = _with(workspace, common)
    refiner = _Best(wider, silent)
    here = replace(structure, coefficients=np.append(structure.coefficients, np.zeros(len(common))))
    found = refiner.refine(here, _ROUNDS)
    gain = 2.0 * (refiner.value(found) - refiner.value(here))
    new = [wider.columns.terms[m].text for m in found.members if m >= len(columns)]
    threshold = _BETTER + _RELEVANT * float(structure.fit.weights.slack.sum())
    # a law says it with fewer terms, or holds; on hardware more terms always explain a little more
    fewer = len(found.members) <= len(structure.members)
    lawful = fewer or (not hold and equations_hold(wider, found))
    if not (new and lawful and found.fit.converged and gain > threshold):
        return []
    by = f" (-2 log likelihood {gain:.0f}, the price of the terms included)" if np.isfinite(gain) else ""
    free = f"{len(found.members)} free terms instead of {len(structure.members)}"
    return [_say(new, f"{free} explain the motion better{by}")]


def searched_terms(workspace: Workspace) -> list[str]:
    """Say with which common terms a new search finds a law, where no structure explains the motion.

    There :func:`lacking_terms` has no fit from which one more term would lead to the law.
    """
    columns, common = workspace.columns, _not_offered(workspace.columns, "standard")
    if not common or workspace.trajectories.n_samples > _MOST_SAMPLES:
        return []
    wider = _with(workspace, common)
    curve = smooth(wider.grid, wider.times, wider.values, rates=wider.rates)
    found = best_structure(Refiner(wider, silent), propose_supports(wider, curve, silent), None)
    new = [wider.columns.terms[m].text for m in found.members if m >= len(columns)]
    if not (new and found.fit.converged and equations_hold(wider, found)):
        return []
    return [_say(new, f"{len(found.members)} free terms explain the motion")]


def _with(workspace: Workspace, terms: list[Term]) -> Workspace:
    return workspace.changed(np.append(workspace.known, np.full(len(terms), np.nan)), terms)


def _say(new: list[str], what: str) -> str:
    it = "it" if len(new) == 1 else "them"
    return f"the library seems to lack {', '.join(new)}: with {it}, {what}; add {it} to the candidates"


class _Best(Refiner):
    """Tries only the best proposal of each round: with the term that is lacking it succeeds at once."""

    def _propose(self, structure: StructureFit) -> Iterator[tuple[tuple[int, ...], Start]]:
        return islice(super()._propose(structure), 1)


def _not_offered(columns: EulerLagrange, size: str) -> list[Term]:
    """Terms that mechanical systems are usually made of, beyond the span of the candidates."""
    given = [term for term in columns.terms if term.kind == "lagrangian"]
    together = [columns.coordinates]
    if len(columns.coordinates) > _MOST_TOGETHER:
        together = [(name,) for name in columns.coordinates]
    usual = [
        term.text
        for names in together
        for term in Library.mechanical(
            names, [n for n in columns.turning if n in names], size=size, gyroscopic=size != "compact"
        ).terms
    ]
    texts = {term.text for term in given}
    both = Library([*texts, *(text for text in usual if text not in texts)], columns.coordinates)
    kept = both.reduced(keep=[term for term in both.terms if term.text in texts])
    return [term for term in kept.terms if term.text not in texts]
