"""Families of terms with shape parameters that the candidates may imitate.

Those of the families of `leastaction.selection.families` are searched with.  One is named if its law is
likelier by the evidence, its equations hold, and it leaves no doubt about the form itself.  One that leaves
such a doubt still shows that a law of which it is likelier by more than chance is not the right one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from leastaction.diagnosis.effects import compared_accelerations
from leastaction.diagnosis.missing_terms import missing_term
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.diagnosis.shapes import chance
from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.diagnosis.wider_search import MOST_SAMPLES
from leastaction.estimation.fit import Fit
from leastaction.findings import Finding, find
from leastaction.selection.families import helpful_families, looks_imitated, searched_with
from leastaction.selection.likelihood_refinement import value
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.strategies import feeding_friction, finer_knots, shape_fit

__all__ = ["lacking_family", "named_family", "simpler_form"]


def named_family(doubt: Finding, search: Search) -> Finding:
    """A doubt about the form of a law, with the family that would help, if one does."""
    helpful = _helpful(search, doubt.values["kind"] == "kinetic")
    if helpful is None:
        return doubt
    texts, numbers = helpful.as_offered()
    return find(doubt.code, **{**doubt.values, "family": texts, "numbers": numbers})


def lacking_family(search: Search) -> list[Finding]:
    """Terms with unknown numbers with which the equations hold; nothing if none are found."""
    helpful = _helpful(search, kinetic=False)
    if helpful is None:
        return []
    texts, numbers = helpful.as_offered()
    free = len(helpful.fit.structure)
    return [missing_term(texts, search.found.problem.coordinates, free_terms=free, numbers=numbers)]


def simpler_form(search: Search) -> list[Finding]:
    """A law with a family that is likelier than a long one that was found; nothing if there is none.

    Many terms of positions alone, or masses that depend on positions, are what imitations consist of.  Of
    laws that may themselves imitate another the likeliest counts, if it is so by more than chance.
    """
    fit = search.found
    laws = list(_until_helpful(search, kinetic=False)) if looks_imitated(fit) else []
    laws = [law for law in laws if not law.doubtful or 2.0 * law.gain > chance(law.fit, law.own)]
    if not laws:
        return []
    law = min(laws, key=lambda law: (law.doubtful, -law.gain))
    shift = _difference(fit, law.fit)
    if shift <= DIAGNOSIS.form_matters:  # the same law in fewer terms
        return []
    family, numbers = law.as_offered()
    lengths = {"free_terms": len(law.fit.structure), "instead_of": len(fit.structure)}
    imitated = "a law like it" if law.doubtful else "it"
    figures = {"gain": law.gain, "shift": shift, "imitated": imitated}
    return [find("simpler-form", family=family, numbers=numbers, **figures, **lengths)]


def _difference(fit: Fit, other: Fit) -> float:
    """Root mean square by which accelerations of another law differ from those of a fit, relative to these.

    At states where the equations of the fit hold, those of the other leave M₂ (q̈ − q̈₂).
    """
    points, size = compared_accelerations(fit)

    def sides(law: Fit) -> np.ndarray:
        physics, index = law.grid.physics(law.structure)
        return np.einsum("k,kip->pi", law.coefficients[index], physics.columns.strong(points))

    change = np.linalg.solve(other.mass_matrix(points), (sides(other) - sides(fit))[..., None])[..., 0]
    free = [i for i in range(len(size)) if i not in fit.problem.prescribed]
    return float(np.max((np.sqrt(np.mean(change**2, axis=0)) / size)[free]))


@dataclass(frozen=True, eq=False)
class _Law:
    """A likelier law that is found with a family.

    Attributes
    ----------
    fit : Fit
    names : list of str
        The shape parameters of the family.
    gain : float
        Of the evidence, on the grid of the fit that it is compared with.
    doubtful : bool
        Whether its form is doubtful, too.
    """

    fit: Fit
    names: list[str]
    gain: float
    doubtful: bool

    @property
    def own(self) -> list[int]:
        """Terms of the family in the law."""
        shapes = {m: {*self.fit.problem.terms[m].shapes} for m in self.fit.structure}
        return [m for m, numbers in shapes.items() if numbers & {*self.names}]

    def as_offered(self) -> tuple[list[str], list[str]]:
        """Terms of the family as a user writes them, and their shape parameters."""
        problem = self.fit.problem
        texts = [problem.terms[m].offered for m in self.own]
        return texts, [f"{name} = {problem.shape_values[name]:.3g}" for name in self.names]


def _helpful(search: Search, kinetic: bool) -> _Law | None:
    """The first law without a doubt about its form."""
    return next((law for law in _until_helpful(search, kinetic) if not law.doubtful), None)


def _until_helpful(search: Search, kinetic: bool) -> Iterator[_Law]:
    """Likelier laws that are found with families, up to the first without a doubt about its form."""
    fit = search.found
    if fit.problem.trajectories.n_samples > MOST_SAMPLES:
        return
    for at in helpful_families(search, kinetic):
        gain = value(at.found) - value(fit)
        if not gain > 0.0:
            continue
        # knots laid for the motion of another law may be too coarse for the right one
        found = searched_with(at, finer_knots, shape_fit, feeding_friction).found
        used = {*found.problem.shapes_of(found.structure)} - {*fit.problem.ranges}
        holds = found.converged and equations_hold(found)
        if used and holds:
            law = _Law(found, sorted(used), gain, bool(doubts_about_the_form(found, search.relevance)))
            yield law
            if not law.doubtful:
                return
