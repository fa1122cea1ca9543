"""Write the law that was found in its shortest form.

A grammar writes one function in several ways, of which the search knows one: φ̇² sin² θ, cos(θ−φ) and
cos(θ+φ), but not φ̇² cos 2θ or sin θ sin φ.  With the forms that the members of the structure can write up to
null terms, every structure of members and forms, with coefficients μ, is a restriction of the one that was
found, and the quadratic model of the likelihood prices it,

    λ = M μ,    A → Mᵀ A M,    g → Mᵀ g,

so that fewer terms win where the data allow it (½ cos(θ−φ) − ½ cos(θ+φ) is sin θ sin φ), and shorter ones
otherwise.

Cost: a quadratic model of the members, and a fit for each better form. Skipped where a library has no
description lengths.
Without it (`docs/ablations.md`) laws come out right, but in more terms than they need.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leastaction.data.validation import FloatArray
from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Structure
from leastaction.estimation.weights import Start
from leastaction.library import Dropped
from leastaction.selection.likelihood_refinement import penalty, value
from leastaction.selection.likelihood_search import Choice, QuadraticModel, search_subsets
from leastaction.selection.search_state import Search

__all__ = ["run"]

_TRIED = 3  # forms that are fitted
_GAIN = 1e-3  # of the log likelihood: less is rounding
_INDEPENDENT = 1e-9  # relative rank: rounding


class _Writing(NamedTuple):
    """A way to write the law: the structure's members that stay, forms, and their coefficients."""

    members: tuple[int, ...]
    forms: tuple[Dropped, ...]
    coefficients: FloatArray


def run(search: Search) -> Search:
    """The same law, or a restriction of it that the data prefer, in other terms."""
    fit = search.found
    forms = _forms_within(fit)
    if not forms or not fit.converged:
        return search
    best, found = fit, search
    for writing in _better(fit, forms):
        rewritten = _posed(search, writing)
        other = _fitted(rewritten, fit, writing)
        if other.converged and value(other) > value(best) + _GAIN:
            best, found = other, rewritten.now(other)
    return found


def _forms_within(fit: Fit) -> list[Dropped]:
    """Forms that the members of a structure can write."""
    texts = {fit.problem.terms[m] for m in fit.structure}
    return [form for form in fit.problem.forms if all(term in texts for _, term in form.combination)]


def _mixing(fit: Fit, forms: Sequence[Dropped]) -> FloatArray:
    """(n_members, n_members + n_forms) coefficients of the members in members and forms."""
    place = {fit.problem.terms[m]: k for k, m in enumerate(fit.structure)}
    mixing: FloatArray = np.zeros((len(place), len(forms)))
    for j, form in enumerate(forms):
        for factor, term in form.combination:
            mixing[place[term], j] += factor
    return np.hstack([np.eye(len(place)), mixing])


def _better(fit: Fit, forms: Sequence[Dropped]) -> list[_Writing]:
    """Ways to write the law that the quadratic model prefers, the best first."""
    members, mixing = fit.structure.members, _mixing(fit, forms)
    quadratic = fit.score(fit.problem.candidates.subset(list(members)))
    dearer = fit.problem.surcharges_of([form.length for form in forms])
    model = QuadraticModel(
        mixing.T @ quadratic.matrix @ mixing,
        mixing.T @ quadratic.gradient,
        np.concatenate([fit.estimates, np.zeros(len(forms))]),
        np.concatenate([fit.problem.surcharges[list(members)], dearer]),
    )
    price, now = penalty(fit.grid), tuple(range(len(members)))
    levels = search_subsets(model, now, price)
    choices = sorted((c for level in levels.values() for c in level), key=lambda c: c.criterion(price))
    here = next((n for n, choice in enumerate(choices) if choice.members == now), len(choices))
    able = [c for c in choices[:here] if _independent(mixing[:, list(c.members)])]
    return [_writing(model, members, forms, choice) for choice in able[:_TRIED]]


def _independent(columns: FloatArray) -> bool:
    return bool(np.linalg.matrix_rank(columns, _INDEPENDENT) == columns.shape[1])


def _writing(
    model: QuadraticModel, members: tuple[int, ...], forms: Sequence[Dropped], choice: Choice
) -> _Writing:
    n, coefficients = len(members), model.solution(choice.members)
    stay = [k for k in choice.members if k < n]
    new = [k for k in choice.members if k >= n]
    return _Writing(
        tuple(members[k] for k in stay), tuple(forms[k - n] for k in new), coefficients[[*stay, *new]]
    )


def _places(fit: Fit, writing: _Writing) -> list[int]:
    """The members that give way to the forms, so that the candidates stay independent."""
    columns = _mixing(fit, writing.forms)
    n = len(fit.structure)
    place = {m: k for k, m in enumerate(fit.structure)}
    kept = [place[m] for m in writing.members] + list(range(n, n + len(writing.forms)))
    out: list[int] = []
    for k, member in enumerate(fit.structure):
        if k in kept:
            continue
        if _independent(columns[:, [*kept, k]]):
            kept.append(k)
        else:
            out.append(member)
    return out


def _posed(search: Search, writing: _Writing) -> Search:
    """The search with the forms among the candidates, in the places of members that they make redundant."""
    forms = dict(zip(_places(search.found, writing), writing.forms, strict=True))
    return search.posed(lambda problem: problem.exchanged(forms))


def _fitted(search: Search, before: Fit, writing: _Writing) -> Fit:
    places = [*writing.members, *_places(before, writing)]
    coefficients = before.coefficients.copy()
    coefficients[list(before.structure)] = 0.0
    coefficients[places] = writing.coefficients
    start = Start(before.control_points, coefficients, before.weights)
    return search.grid.fit(Structure(places), start)
