"""Does the law depend on time?  Forces and coefficients that oscillate are tried, at every frequency.

The equation error of such a law follows the clock, not the state.  It is explained by φ(q) cos(ω t + δ),
where φ is a coordinate (a force on it) or a potential (a coefficient that oscillates), or by a factor that
drifts, φ t and φ exp(−a t).  What they gain is read from the quadratic model of the likelihood about the fit,
at frequencies a quarter of a turn apart at the latest time.  A search with the best frequency decides, and a
further one is looked for where an error is left.  The law is said to depend on time if its
equations hold, and no smooth change of a potential is left that would explain more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.diagnosis.wider_search import searched_with
from leastaction.estimation.fit import Fit
from leastaction.estimation.shape_ranges import ShapeRange, frequency_range, shape_ranges
from leastaction.findings import Finding, find
from leastaction.identifiers import TIME, names_in_terms
from leastaction.library import Term, make_term, shape_names, time_symbol
from leastaction.selection.progress import silent
from leastaction.selection.search_state import Search, equations_hold, restarted
from leastaction.selection.strategies import feeding_friction, shape_fit, weak_start
from leastaction.selection.strategies.frequency_scan import best_number

__all__ = ["time_dependence"]

_ROUNDS = 3  # functions of time in one law, at most
_MOST_FACTORS = 12  # bounds time
_MOST_FREQUENCIES = 1000  # bounds time
# of the factor and the name of a frequency or rate
_WAVE = ("{0}*cos({{{1}}}*t)", "{0}*sin({{{1}}}*t)")
_DRIFT = ("{0}*t", "{0}*exp(-{{{1}}}*t)")


@dataclass(frozen=True)
class _Offer:
    """Factors times functions of time, with the number that explains the most.

    Attributes
    ----------
    terms : tuple of Term
        For every factor φ, with the number in place.
    ranges : mapping of str to ShapeRange
        Of the one shape parameter.
    gain : float
        By how much −2 log likelihood falls with the terms of one factor, beyond chance.
    """

    terms: tuple[Term, ...]
    ranges: Mapping[str, ShapeRange]
    gain: float


def time_dependence(search: Search) -> list[Finding]:
    """Say with which terms that hold the time the equations hold; nothing if none are found."""
    factors = _factors(search.found)
    for _ in range(_ROUNDS):
        fit = search.found
        if not (fit.converged and np.isfinite(fit.evidence)):
            return []
        offer = _best(fit, factors)
        if offer is None:
            return []
        search = searched_with(_posed(search, offer), weak_start, shape_fit, feeding_friction)
        if equations_hold(search.found):
            # waves imitate a potential that no candidate can write; a smooth change of it remains
            imitated = doubts_about_the_form(search.found, search.relevance)
            return [] if imitated else _as_finding(search.found)
    return []


def _as_finding(fit: Fit) -> list[Finding]:
    """The terms that hold the time, and the numbers in them (rad/s, 1/s)."""
    if not fit.converged:
        return []
    held = [fit.problem.terms[m] for m in fit.structure]
    written = [term if term.template is None else term.template.term for term in held]
    texts = [term.text for term in written if time_symbol in term.expr.free_symbols]
    names = shape_names([term for term in written if term.text in texts])
    numbers = [f"{name} = {fit.problem.shape_values[name]:.4g}" for name in names]
    return [find("time-dependent", texts, numbers=numbers, free_terms=len(held))] if texts else []


def _factors(fit: Fit) -> list[str]:
    """Forces on the coordinates, their simplest potentials, and the potentials of the law found."""
    problem = fit.problem
    forces = [name for i, name in enumerate(problem.coordinates) if i not in problem.prescribed]
    simplest = [
        text
        for name in forces
        for text in (
            [f"cos({name})", f"sin({name})"] if name in problem.candidates.turning else [f"{name}**2"]
        )
    ]
    states = {*problem.coordinates}
    held = [problem.terms[m] for m in fit.structure]
    potentials = [t for t in held if t.template is None and {str(s) for s in t.expr.free_symbols} <= states]
    found = [f"({t.text})" if t.expr.is_Add else t.text for t in potentials]
    return list(dict.fromkeys([*forces, *simplest, *found]))[:_MOST_FACTORS]


def _best(fit: Fit, factors: Sequence[str]) -> _Offer | None:
    """The offer with which one factor explains the most, if that is more than chance does."""
    offers = [_offer(fit, factors, *functions) for functions in (("w", *_WAVE), ("a", *_DRIFT))]
    best = max(offers, key=lambda offer: offer.gain)
    return best if best.gain > 0.0 else None


def _offer(fit: Fit, factors: Sequence[str], letter: str, *functions: str) -> _Offer:
    """Factors times functions of time, which share the number that explains the most beside one of them."""
    names = names_in_terms(fit.problem.coordinates)
    taken = {*names, *fit.problem.ranges}
    name = next(n for k in count() if (n := f"{letter}{k or ''}") not in taken)
    groups = [[make_term(f.format(factor, name), names) for f in functions] for factor in factors]
    times = np.asarray(fit.points().times)
    if functions == _WAVE:
        where = frequency_range(times, most=_MOST_FREQUENCIES)
    else:
        where = shape_ranges(groups[0], {TIME: times}, {})[name]
    _, number, gain = best_number(fit, groups, name, where)
    return _Offer(tuple(term.at({name: number}) for group in groups for term in group), {name: where}, gain)


def _posed(search: Search, offer: _Offer) -> Search:
    """A search on the grid of the fit that has the offer among its candidates."""
    before = search.found.problem
    problem = replace(before.wider(offer.terms), ranges={**before.ranges, **offer.ranges})
    return restarted(replace(search, report=silent), search.found.grid.posed(problem))
