"""Test for missing terms: common terms that are not candidates are tried on the final fit.

Where a term is missing, others imitate it, along these data well enough to leave hardly any equation error.
With the term itself fewer terms suffice, and the likelihood less the price of the terms is higher.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.groups import GroupTerm
from leastaction.findings import Finding, find
from leastaction.library import Library, Term
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.likelihood_refinement import refine, value
from leastaction.selection.search_state import equations_hold
from leastaction.selection.significance import chi_square_cutoff

__all__ = ["Cause", "common_terms", "lacking_terms", "missing_term"]

_MOST_TOGETHER = 3  # coordinates; of more, functions of several are left out, there are hundreds of them
_ROUNDS = 3  # a missing term is among the first


@dataclass(frozen=True)
class Cause:
    """What would explain the motion better.

    Attributes
    ----------
    finding : Finding
    gain : float
        By how much it lowers −2 log likelihood, the price of every term included.
    holds : bool
        Whether the equations hold with it.
    """

    finding: Finding
    gain: float
    holds: bool


def lacking_terms(fit: Fit, relevance: float) -> list[Cause]:
    """Common terms that explain the motion better than the candidates."""
    if not fit.converged:
        return []
    hold = equations_hold(fit)
    found = _with_common(fit, relevance, hold, "compact")
    if not found and not hold:
        found = _with_common(fit, relevance, hold, "standard")
    return found


def _with_common(fit: Fit, relevance: float, hold: bool, size: str) -> list[Cause]:
    columns = fit.problem.candidates
    common = common_terms(columns, size)
    if not common:
        return []
    here = fit.posed(fit.problem.wider(common))
    # with the missing term, the best proposal succeeds at once
    found = refine(here, rounds=_ROUNDS, most=1)
    gain = 2.0 * (value(found) - value(here))
    new = [found.problem.terms[m].text for m in found.structure if m >= len(columns)]
    if not new:
        return []
    # the price of the terms is in the gain; an exchange for one of many others pays none
    chance = chi_square_cutoff(len(new), comb(len(common), len(new)))
    threshold = chance + fit.relevant_gain(relevance)
    # a law needs fewer terms, or holds; on hardware, more terms always explain a little more
    fewer = len(found.structure) <= len(fit.structure)
    holds = equations_hold(found)
    if not ((fewer or (holds and not hold)) and found.converged and gain > threshold):
        return []
    figures = {
        "free_terms": len(found.structure),
        "free_terms_before": len(fit.structure),
        "gain": gain if np.isfinite(gain) else None,
    }
    return [Cause(missing_term(new, columns.coordinates, **figures), gain, holds)]


def missing_term(new: list[str], coordinates: Sequence[str], **figures: float | list[str] | None) -> Finding:
    """Names candidates to add; a coordinate by itself is a constant force on it.

    The figures are the free terms with them and, where known, without them, and the gain.
    """
    pushed = next((text for text in new if text in coordinates), None)
    return find("missing-term", new, constant_force=pushed, **figures)


def common_terms(columns: EulerLagrange, size: str, turning: Sequence[str] | None = None) -> list[Term]:
    """Terms that mechanical systems are usually made of, beyond the span of the candidates.

    The coordinates that count as angles are those of the candidates, or others.
    """
    angles = columns.turning if turning is None else turning
    given = [t for t in columns.terms if t.kind == "lagrangian" and not isinstance(t, GroupTerm)]
    together = [columns.coordinates]
    if len(columns.coordinates) > _MOST_TOGETHER:
        together = [(name,) for name in columns.coordinates]
    usual = [
        term.text
        for names in together
        for term in Library.mechanical(
            names, [n for n in angles if n in names], size=size, gyroscopic=size != "compact"
        ).terms
    ]
    texts = {term.text for term in given}
    both = Library([*texts, *(text for text in usual if text not in texts)], columns.coordinates)
    driven = [columns.coordinates[i] for i in columns.prescribed]
    kept = both.reduced(keep=[term for term in both.terms if term.text in texts], prescribed=driven)
    return [term for term in kept.terms if term.text not in texts]
