"""Does the library lack a term?  Common ones that are not among the candidates are tried on the final fit.

Where a needed term is missing others imitate it, along these data well enough to leave hardly any equation
error.  With the term itself fewer do, and the likelihood, less the price of the terms, is higher.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from leastaction.diagnosis.cause import Cause
from leastaction.estimation.weights import Start
from leastaction.estimation.workspace import StructureFit, Workspace
from leastaction.findings import Finding, find
from leastaction.library import Library, Term
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.knots import BETTER, RELEVANT, equations_hold, silent
from leastaction.selection.select import Refiner, Selection

__all__ = ["common_terms", "lacking_terms", "missing_term"]

_MOST_TOGETHER = 3  # coordinates; of more, functions of several are left out, there are hundreds of them
_ROUNDS = 3  # a term that is lacking is found in the first


def lacking_terms(workspace: Workspace, selection: Selection) -> list[Cause]:
    """Common terms that would explain the motion better than the candidates do."""
    if not selection.structure.fit.converged:
        return []
    hold = equations_hold(workspace, selection.structure)
    found = _with_common(workspace, selection.structure, hold, "compact")
    if not found and not hold:
        found = _with_common(workspace, selection.structure, hold, "standard")
    return found


def _with_common(workspace: Workspace, structure: StructureFit, hold: bool, size: str) -> list[Cause]:
    columns = workspace.columns
    common = common_terms(columns, size)
    if not common:
        return []
    wider = workspace.wider(common)
    refiner = _Best(wider, silent)
    here = replace(structure, coefficients=np.append(structure.coefficients, np.zeros(len(common))))
    found = refiner.refine(here, _ROUNDS)
    gain = 2.0 * (refiner.value(found) - refiner.value(here))
    new = [wider.columns.terms[m].text for m in found.members if m >= len(columns)]
    threshold = BETTER + RELEVANT * float(structure.fit.weights.slack.sum())
    # a law says it with fewer terms, or holds; on hardware more terms always explain a little more
    fewer = len(found.members) <= len(structure.members)
    holds = equations_hold(wider, found)
    if not (new and (fewer or (holds and not hold)) and found.fit.converged and gain > threshold):
        return []
    figures = {
        "free_terms": len(found.members),
        "free_terms_before": len(structure.members),
        "gain": gain if np.isfinite(gain) else None,
    }
    return [Cause(missing_term(new, columns.coordinates, **figures), gain, holds)]


def missing_term(new: list[str], coordinates: Sequence[str], **figures: float | None) -> Finding:
    """Names candidates to add; a coordinate by itself is a constant force on it.

    The figures are the free terms with them and, where known, without them, and the gain.
    """
    pushed = next((text for text in new if text in coordinates), None)
    return find("missing-term", new, constant_force=pushed, **figures)


class _Best(Refiner):
    """Tries only the best proposal of each round: with the term that is lacking it succeeds at once."""

    def _propose(self, structure: StructureFit) -> Iterator[tuple[tuple[int, ...], Start]]:
        return islice(super()._propose(structure), 1)


def common_terms(columns: EulerLagrange, size: str) -> list[Term]:
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
    driven = [columns.coordinates[i] for i in columns.prescribed]
    kept = both.reduced(keep=[term for term in both.terms if term.text in texts], prescribed=driven)
    return [term for term in kept.terms if term.text not in texts]
