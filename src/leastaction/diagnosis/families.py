"""Families of terms with shape parameters that the candidates may imitate.

Those of the families of `leastaction.selection.families` are searched with.  One is named if its law is
likelier by the evidence, its equations hold, and it leaves no doubt about the form itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from leastaction.diagnosis.effects import compared_accelerations
from leastaction.diagnosis.missing_terms import missing_term
from leastaction.diagnosis.settings import DIAGNOSIS
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
    texts, numbers = _as_offered(*helpful[:2])
    return find(doubt.code, **{**doubt.values, "family": texts, "numbers": numbers})


def lacking_family(search: Search) -> list[Finding]:
    """Terms with unknown numbers with which the equations hold; nothing if none are found."""
    helpful = _helpful(search, kinetic=False)
    if helpful is None:
        return []
    texts, numbers = _as_offered(*helpful[:2])
    free = len(helpful[0].structure)
    return [missing_term(texts, search.found.problem.coordinates, free_terms=free, numbers=numbers)]


def simpler_form(search: Search) -> list[Finding]:
    """A law with a family that is likelier than a long one that was found; nothing if there is none.

    Many terms of positions alone, or masses that depend on positions, are what imitations consist of.
    """
    fit = search.found
    helpful = _helpful(search, kinetic=False) if looks_imitated(fit) else None
    if helpful is None:
        return []
    found, names, gain = helpful
    shift = _difference(fit, found)
    if shift <= DIAGNOSIS.form_matters:  # the same law in fewer terms
        return []
    family, numbers = _as_offered(found, names)
    lengths = {"free_terms": len(found.structure), "instead_of": len(fit.structure)}
    return [find("simpler-form", family=family, numbers=numbers, gain=gain, shift=shift, **lengths)]


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


def _as_offered(found: Fit, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Terms of the structure as a user writes them, and their shape parameters."""
    templates = [found.problem.terms[m].template for m in found.structure]
    texts = [t.term.text for t in templates if t is not None and {*t.term.shapes} & {*names}]
    return texts, [f"{name} = {found.problem.shape_values[name]:.3g}" for name in names]


def _helpful(search: Search, kinetic: bool) -> tuple[Fit, list[str], float] | None:
    """A better law that is found with a family, the shape parameters of that, and by how much it is better.

    The values are compared on the grid of the fit.
    """
    fit = search.found
    if fit.problem.trajectories.n_samples > MOST_SAMPLES:
        return None
    for at in helpful_families(search, kinetic):
        gain = value(at.found) - value(fit)
        if not gain > 0.0:
            continue
        # knots laid for the motion of another law may be too coarse for the right one
        found = searched_with(at, finer_knots, shape_fit, feeding_friction).found
        used = {*found.problem.shapes_of(found.structure)} - {*fit.problem.ranges}
        holds = found.converged and equations_hold(found)
        if used and holds and not doubts_about_the_form(found, search.relevance):
            return found, sorted(used), gain
    return None
