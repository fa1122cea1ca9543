"""Does the law depend on time?  Forces and coefficients that oscillate are tried, at every frequency.

The equation error of such a law follows the clock, not the state.  It is explained by φ(q) cos(ω t + δ),
where φ is a coordinate (a force on it) or a potential (a coefficient that oscillates), or by a factor that
drifts, φ t and φ exp(−a t).  What they gain is read from the quadratic model of the likelihood about the fit,
at frequencies a quarter of a turn apart at the latest time.  A search with the best one decides; another one
follows where an error is left.  The law is said to depend on time if its equations then hold, and no smooth
change of a potential would explain more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.estimation.fit import Fit
from leastaction.estimation.forces import WithPushes
from leastaction.estimation.shape_ranges import frequency_range, shape_ranges
from leastaction.findings import Finding, find
from leastaction.identifiers import TIME, free_name, names_in_terms
from leastaction.library import Term, make_term, shape_names, time_symbol
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points
from leastaction.selection.families import Offer, offered, searched_with
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.strategies import feeding_friction, shape_fit, weak_start
from leastaction.selection.strategies.frequency_scan import best_number

__all__ = ["time_dependence"]

_ROUNDS = 3  # functions of time in one law, at most
_MOST_FACTORS, _MOST_FREQUENCIES = 12, 1000  # bound the time that it takes


@dataclass(frozen=True)
class _Kind:
    """Two functions of time that belong together, and the letter of their frequency or rate.

    Texts have gaps for a factor and that name; functions take the time in units of that number.
    """

    letter: str
    texts: tuple[str, str]
    functions: tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]


_WAVE = _Kind("w", ("{0}*cos({{{1}}}*t)", "{0}*sin({{{1}}}*t)"), (np.cos, np.sin))
_DRIFT = _Kind("a", ("{0}*t", "{0}*exp(-{{{1}}}*t)"), (lambda u: u, lambda u: np.exp(-u)))


def time_dependence(search: Search) -> list[Finding]:
    """Say with which terms that hold the time the equations hold; nothing if none are found."""
    factors = _factors(search.found)
    for _ in range(_ROUNDS):
        fit = search.found
        if not (fit.converged and np.isfinite(fit.evidence)) or (offer := _best(fit, factors)) is None:
            return []
        search = searched_with(offered(search, offer), weak_start, shape_fit, feeding_friction)
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
    turning = problem.candidates.turning
    simplest = [t for q in forces for t in ((f"cos({q})", f"sin({q})") if q in turning else (f"{q}**2",))]
    states, held = {*problem.coordinates}, [problem.terms[m] for m in fit.structure]
    potentials = [t for t in held if t.template is None and {str(s) for s in t.expr.free_symbols} <= states]
    found = [f"({t.text})" if t.expr.is_Add else t.text for t in potentials]
    return list(dict.fromkeys([*forces, *simplest, *found]))[:_MOST_FACTORS]


def _best(fit: Fit, factors: Sequence[str]) -> Offer | None:
    """The offer with which one factor explains the most, if that is a good part of the equation error."""
    names = names_in_terms(fit.problem.coordinates)
    pushes = _forces(fit, [make_term(factor, names) for factor in factors])
    offers = [_offer(fit, factors, pushes, kind) for kind in (_WAVE, _DRIFT)]
    best = max(offers, key=lambda offer: offer.worth)
    return best if best.worth > fit.relevant_gain(DIAGNOSIS.wave_share) else None


def _forces(fit: Fit, terms: Sequence[Term]) -> np.ndarray:
    """(n_terms, n_intervals, n_quadrature, n_dof) forces of potentials along the curve."""
    spline = fit.grid.spline
    states = spline.at_quadrature(fit.control_points)
    points = Points(*(s.reshape(-1, s.shape[2]) for s in states))
    values = fit.problem.candidates.of(terms).strong(points)
    return values.transpose(0, 2, 1).reshape(len(terms), *states[0].shape)


@dataclass(frozen=True)
class _Changing:
    """Forces times both functions of time, for every number."""

    force: np.ndarray
    times: np.ndarray
    kind: _Kind
    numbers: np.ndarray

    def __len__(self) -> int:
        return 2 * self.numbers.size

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        phase = self.numbers[:, None] * self.times[intervals].T.ravel()
        values = np.stack([function(phase) for function in self.kind.functions], axis=1)
        return values.reshape(len(self), 1, -1) * self.force[intervals].transpose(2, 1, 0).reshape(n_dof, -1)

    def within(self, intervals: slice) -> _Changing:
        return replace(self, force=self.force[intervals], times=self.times[intervals])


def _offer(fit: Fit, factors: Sequence[str], forces: np.ndarray, kind: _Kind) -> Offer:
    """Factors times functions of time, which share the number that explains the most beside one of them."""
    names, times = names_in_terms(fit.problem.coordinates), fit.grid.spline.points
    name = free_name(kind.letter, {*names, *fit.problem.ranges})
    terms = [make_term(text.format(factor, name), names) for factor in factors for text in kind.texts]
    if kind is _WAVE:
        where = frequency_range(times[:, 0], most=_MOST_FREQUENCIES)
    else:
        where = shape_ranges(terms[:2], {TIME: times[:, 0]}, {})[name]
    chosen = fit.problem.candidates.subset(list(fit.structure))

    def columns(group: int, numbers: np.ndarray) -> EulerLagrange:
        return WithPushes(chosen, _Changing(forces[group], times, kind, numbers))

    _, number, gain = best_number(fit, columns, len(factors), 2, where)
    return Offer([term.at({name: number}) for term in terms], {name: where}, gain)
