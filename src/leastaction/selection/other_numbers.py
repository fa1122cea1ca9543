"""Laws with other shape parameters that promise as much as a fit, by the quadratic model about it.

Beside plain candidates that imitate a law, the weak form hardly tells numbers apart: with wrong ones, the
plain candidates make up for the difference.  The likelihood tells which of them are superfluous beside the
right numbers.  So a fit is scored with the terms at each of many numbers, and with the tangents, whose
coefficients are a Gauss–Newton step; then plain terms are dropped while that is worth their price.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Structure
from leastaction.estimation.shape_ranges import shape_starts
from leastaction.estimation.weights import Start
from leastaction.library import tangent
from leastaction.library.grammar import size_of
from leastaction.selection.likelihood_refinement import beside, penalty
from leastaction.selection.likelihood_search import Choice, QuadraticModel
from leastaction.selection.settings import SELECTION

__all__ = ["differing_terms", "laws_elsewhere"]

_STARTS = {1: 33}  # of a group with so many shape parameters
_MOST_STARTS = 64  # of a group with more
_BESIDE = 24  # plain candidates, the shortest, beside those of the fit
_FITTED = 3  # laws, at most
_SPARE = 3  # members whose removal is computed, since rounding may reorder near-ties


def laws_elsewhere(fit: Fit, groups: Sequence[tuple[str, ...]]) -> list[Fit]:
    """Fits of the best laws with other numbers, each of another structure.

    Parameters
    ----------
    fit : Fit
    groups : sequence of tuple of str
        Shape parameters that are moved together, those of one group at a time.
    """
    if not fit.usable or not np.isfinite(fit.evidence):
        return []
    price = penalty(fit.grid)
    promises = [p for names in groups for p in _promises(fit, names, price) if p.loss < price]
    best: dict[Structure, _Promise] = {}
    for promise in sorted(promises, key=lambda p: p.loss):
        best.setdefault(promise.structure, promise)
    best.pop(fit.structure, None)
    return [promise.fitted(fit) for promise in [*best.values()][:_FITTED]]


@dataclass(frozen=True, eq=False)
class _Promise:
    """A law with other numbers, and what it loses; less is better."""

    loss: float
    structure: Structure
    coefficients: np.ndarray
    values: Mapping[str, float]
    steps: Mapping[str, float]

    def fitted(self, fit: Fit) -> Fit:
        """The fit of the law, from the curve of another."""
        problem = fit.problem.at(self.values).stepped(self.steps)
        start = Start(fit.control_points, self.coefficients, fit.weights)
        return fit.grid.posed(problem).fit(self.structure, start)


def _promises(fit: Fit, names: tuple[str, ...], price: float) -> Iterator[_Promise]:
    """At each start, the terms with these numbers and those plain ones that are worth their price."""
    problem = fit.problem
    terms = problem.terms
    free: list[int] = problem.free.tolist()
    bearers = [k for k in free if {*terms[k].shapes} & {*names}]
    if not bearers:
        return
    pairs = [(k, name) for k in bearers for name in terms[k].shapes if name in names]
    here = [*fit.structure, *_shortest(fit)]
    starts = list(shape_starts({n: problem.ranges[n] for n in names}, _STARTS.get(len(names), _MOST_STARTS)))
    columns = [terms[k] for k in here]
    for start in starts:
        at = {k: terms[k].at(start) for k in bearers}
        columns += [*at.values(), *(tangent([at[k]], [1.0], name) for k, name in pairs)]
    model, _ = beside(fit, problem.candidates.of(columns))
    first, size = len(here), len(bearers) + len(pairs)
    plain = [n for n, k in enumerate(here) if k not in bearers]
    before = len(fit.structure) + len({*names} & {*problem.shapes_of(fit.structure)})
    for begin, start in zip(range(first, len(columns), size), starts, strict=True):
        places = [*range(first), *range(begin, begin + size)]
        part = model.among(places)
        if not np.isfinite(part.matrix).all():
            continue
        choice = _without_superfluous(part, plain, range(first, first + size), price)
        kept = [n for n in choice.members if n < first]
        found = part.solution(choice.members) * model.scale[places]
        coefficients = problem.completed(0.0)
        coefficients[[here[n] for n in kept] + bearers] = found[[*kept, *range(first, first + len(bearers))]]
        steps = _steps(pairs, coefficients, found[first + len(bearers) :])
        loss = choice.cost + price * (len(kept) + len(bearers) + len(names) - before)
        yield _Promise(loss, Structure([here[n] for n in kept] + bearers), coefficients, start, steps)


def _steps(
    pairs: Sequence[tuple[int, str]], coefficients: np.ndarray, slopes: np.ndarray
) -> dict[str, float]:
    """The step of each number that comes nearest to the coefficients of its tangents."""
    over, under = dict[str, float](), dict[str, float]()
    for (k, name), slope in zip(pairs, slopes.tolist(), strict=True):
        over[name] = over.get(name, 0.0) + coefficients[k] * slope
        under[name] = under.get(name, 0.0) + coefficients[k] ** 2
    return {name: over[name] / under[name] for name in over if under[name] > 0.0}


def _shortest(fit: Fit) -> list[int]:
    """The shortest of the plain candidates that a fit has not."""
    problem = fit.problem
    free: list[int] = problem.free.tolist()
    absent = [k for k in free if k not in fit.structure and not problem.terms[k].shapes]
    return sorted(absent, key=lambda k: size_of(problem.terms[k].expr))[:_BESIDE]


def _without_superfluous(
    model: QuadraticModel, plain: Sequence[int], own: Sequence[int], price: float
) -> Choice:
    """The best support met while plain columns are dropped one by one; its own columns stay."""
    here = model.best({tuple(sorted([*plain, *own]))}, 1)[0]
    best = here
    for _ in plain:
        removed = model.neighbours(here.members).removed
        order = sorted((n for n, m in enumerate(here.members) if m in plain), key=lambda n: removed[n])
        smaller = {here.members[:n] + here.members[n + 1 :] for n in order[:_SPARE]}
        here = model.best(smaller, 1)[0]
        if here.criterion(price) < best.criterion(price):
            best = here
    return best


def differing_terms(one: Fit, other: Fit) -> list[int]:
    """Members of a law that another does not have, or with other shape parameters."""
    moved: set[str] = set()
    if one.shapes is not None and other.shapes is not None:
        both = {*one.shapes.names} & {*other.shapes.names}
        moved = {name for name in both if one.shapes.differs(other.shapes, name, SELECTION.shape_same)}
    terms = one.problem.terms
    return [m for m in one.structure if m not in other.structure or moved & {*terms[m].shapes}]
