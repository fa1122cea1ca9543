"""Fit shape parameters, curve and coefficients together, and drop terms that become redundant.

A term that only made up for wrong numbers loses its worth when these are right.  The opposite happens, too:
numbers that make up for a term that is not there hide its worth, until both are moved at once.

Cost: three to six joint fits, and a search on their quadratic model. Skipped where the structure holds no
shape parameter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Structure
from leastaction.estimation.shapes import fit_shapes, with_tangents
from leastaction.library import exchanges, shape_symbol
from leastaction.selection.likelihood_refinement import beside, gain_of, penalty, refine, value
from leastaction.selection.search_state import Search
from leastaction.selection.settings import SELECTION

__all__ = ["run"]

_ROUNDS = 4  # at most, each with fits
_WEAKEST = 3  # terms tried in turn


def run(search: Search) -> Search:
    """The best structure with its shape parameters at their most likely numbers."""
    fit = search.found
    if not fit.problem.shapes_of(fit.structure) or not fit.usable:
        return search
    fit = fit_shapes(fit)
    for _ in range(_ROUNDS):
        better = _smaller(fit) or _larger(fit) or _other(fit, search)
        if better is None:
            break
        fit = better
    fit = _ordered(fit)
    return search.now(fit)


def _ordered(fit: Fit) -> Fit:
    """The same law with rising numbers in terms that can be exchanged, such as x**{m} and x**{n}."""
    free: list[int] = fit.problem.free.tolist()
    swaps = exchanges([fit.problem.terms[k] for k in free if fit.problem.terms[k].shapes])
    for swap in [swap for _ in swaps for swap in swaps]:  # sorts by exchanges
        numbers, first = fit.problem.shape_values, min(swap)
        alike = all(fit.problem.ranges[a] == fit.problem.ranges[b] for a, b in swap.items())
        used = {*swap} <= {*fit.problem.shapes_of(fit.structure)}
        if alike and used and numbers[first] > numbers[swap[first]]:
            fit = _exchanged(fit, swap)
    return fit


def _exchanged(fit: Fit, swap: Mapping[str, str]) -> Fit:
    """The same law with the numbers of some names exchanged, and the coefficients of their terms."""
    problem, symbols = fit.problem, {shape_symbol(a): shape_symbol(b) for a, b in swap.items()}
    templates = {k: t.template.term.expr for k, t in enumerate(problem.terms) if t.template is not None}
    places = {expr: k for k, expr in templates.items()}
    new = [
        places.get(templates[k].xreplace(symbols), k) if k in templates else k
        for k in range(len(problem.terms))
    ]
    if problem.is_known[[k for k, other in enumerate(new) if k != other]].any():
        return fit
    moved = problem.at({a: problem.shape_values[b] for a, b in swap.items()})
    start = replace(fit.start, coefficients=fit.start.coefficients[new])
    other = fit_shapes(fit.grid.posed(moved).fit(Structure([new[k] for k in fit.structure]), start))
    return other if other.usable else fit


def _smaller(fit: Fit) -> Fit | None:
    """The best fit with fewer terms, if it is better: without one of the weakest, then of those that remain.

    Of terms that resemble each other all are weak, and with other numbers each may explain what another did.
    """
    best = max((_reduced(_without(fit, weak)) for weak in _weakest(fit)), key=value, default=fit)
    return best if value(best) > value(fit) else None


def _reduced(fit: Fit) -> Fit:
    """The fit without its weakest term, and so on, as long as that is better."""
    for weakest in _weakest(fit)[:1]:
        smaller = _without(fit, weakest)
        if value(smaller) > value(fit):
            return _reduced(smaller)
    return fit


def _weakest(fit: Fit) -> list[int]:
    """Members that are worth less than their price, or that another nearly cancels; the weakest first."""
    if len(fit.structure) < 2:
        return []
    errors = np.maximum(fit.standard_errors, 1e-150)
    alike = np.abs(fit.covariance / np.outer(errors, errors)) - np.eye(errors.size)
    cheap = fit.z**2 <= penalty(fit.grid)
    order: list[int] = np.argsort(fit.z**2).tolist()
    tried = [k for k in order if cheap[k] or alike[k].max() > SELECTION.mirrored]
    return [fit.structure.members[k] for k in tried[:_WEAKEST]]


def _without(fit: Fit, member: int) -> Fit:
    return fit_shapes(fit.grid.fit(fit.structure.without([member]), fit.start))


def _larger(fit: Fit) -> Fit | None:
    """The fit with the term that is worth most where the shape parameters may give way, if that is better."""
    names = fit.problem.shapes_of(fit.structure)
    absent = [k for k in fit.problem.free.tolist() if k not in fit.structure]
    if not names or not absent:
        return None
    whole, _ = with_tangents(fit.problem, fit.structure, fit.coefficients, names)
    tangents = range(len(fit.problem.candidates), len(whole.candidates))
    columns = whole.candidates.subset([*fit.structure, *tangents, *absent])
    model, _ = beside(fit, columns)
    here = tuple(range(len(fit.structure) + len(names)))
    gains = [gain_of(model, here, len(here) + n) for n in range(len(absent))]
    price = penalty(fit.grid) + fit.problem.surcharges[absent]
    best = int(np.argmax(gains - price))
    if gains[best] <= price[best]:
        return None
    other = fit_shapes(fit.grid.fit(fit.structure.with_([absent[best]]), fit.start))
    return other if value(other) > value(fit) else None


def _other(fit: Fit, search: Search) -> Fit | None:
    """Another structure that is better with these numbers, and with its own."""
    other = refine(fit, search.report, 2)
    if other.structure == fit.structure:
        return None
    other = fit_shapes(other)
    return other if value(other) > value(fit) else None
