"""Tests for what was not offered: friction, delayed forces, wrong known coefficients.

All are likelihood-ratio tests on the final fit, by the means of the selection: friction that is not among
the candidates is scored beside the chosen terms, and so is what a delay of the forces would leave; a known
coefficient is set free to see whether fewer terms then say the same.  Each has to explain more than chance
does (:mod:`leastaction.selection.significance`); to that comes the relevant share of the equation error's
variance, as in the selection.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import sympy as sp

from leastaction.diagnosis.effects import Effects
from leastaction.diagnosis.missing_terms import Cause
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.estimation.forces import WithPushes, force_rates
from leastaction.findings import Finding, find
from leastaction.library import Library, Term
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.likelihood_refinement import beside, gain_of, refine, value
from leastaction.selection.likelihood_search import QuadraticModel
from leastaction.selection.search_state import equations_hold
from leastaction.selection.significance import chi_square_cutoff

__all__ = [
    "feeding_friction",
    "hidden_friction",
    "late_forces",
    "unmodelled_friction",
    "usual_friction",
    "wrong_known",
]

_MOST_RELEASED = 3  # most known coefficients tested, with a search for each


def hidden_friction(effects: Effects, relevance: float) -> list[Finding]:
    """Friction that is not among the candidates and would explain much of the equation error."""
    fit = effects.fit
    columns = fit.problem.candidates
    tested = usual_friction(columns)
    if not tested:
        return []
    candidates = columns.of([*(columns.terms[m] for m in fit.structure), *tested])
    model, base = beside(fit, candidates)
    found, gain = _most_likely(model, base, dict(enumerate(tested, len(base))))
    if gain <= fit.relevant_gain(relevance):
        return []
    out: list[Finding] = []
    values = model.solution((*base, *found))
    for k in found:
        term, value = candidates.terms[k], float(values[k])
        share = effects.of_terms(candidates.subset([k]), values[[k]])
        others = (*base, *(other for other in found if other != k))
        gain = gain_of(model, others, k)
        figures = {"coefficient": value, "gain": gain, "share": share}
        if effects.slight(share, gain):
            out.append(find("slight-friction", term.text, velocities=_rates(term), **figures))
        elif value > 0.0:
            out.append(unmodelled_friction(term, **figures))
        else:
            out.append(find("energy-fed-in", term.text, velocities=_rates(term), **figures))
    return out


def feeding_friction(effects: Effects, left_out: Sequence[int]) -> list[Finding]:
    """Friction that was left out because it would have fed energy in, where that would be worth knowing.

    Forces that act late look like friction that is negative: what a delay explains is not named twice.
    """
    fit = effects.fit
    columns, out = fit.problem.candidates, list[Finding]()
    for m in left_out:
        term = columns.terms[m]
        if fit.converged:
            candidates = columns.of([*(columns.terms[k] for k in fit.structure), term])
            model, base = beside(fit, candidates)
            value = model.solution((*base, len(base)))[[len(base)]]
            share = effects.of_terms(candidates.subset([len(base)]), value)
            if share <= DIAGNOSIS.worth_knowing or _is_delay(fit, candidates):
                continue
        out.append(find("negative-dissipation", term.text))
    return out


def _is_delay(fit: Fit, candidates: EulerLagrange) -> bool:
    """Whether a delay of the forces leaves nothing for the last of the candidates, a friction, to explain."""
    if fit.grid.forces is None:
        return False
    model, base = beside(fit, WithPushes(candidates, _Late(rates_of_forces(fit))))
    chosen, friction, delay = base[: len(fit.structure)], len(fit.structure), len(fit.structure) + 1
    known = (*chosen, delay)
    certain = chi_square_cutoff()
    return gain_of(model, chosen, delay) > certain and gain_of(model, known, friction) <= certain


def rates_of_forces(fit: Fit) -> np.ndarray:
    """Derivatives of the given forces at the quadrature points."""
    assert fit.grid.forces is not None
    given = [trajectory.forces for trajectory in fit.problem.trajectories]
    return force_rates(fit.grid.spline, fit.grid.times, given, fit.grid.forces.values.dtype.type)


def _most_likely(
    model: QuadraticModel, base: tuple[int, ...], tested: dict[int, Term]
) -> tuple[tuple[int, ...], float]:
    """The friction that explains most, and how much beyond chance; it may be negative where it is viscous.

    Terms are added and dropped one at a time: a damper between two joints does for friction in both, until
    both are there.
    """
    # the exponent of the velocity is one more parameter of friction that is not viscous
    count = len(tested)
    prices = {k: chi_square_cutoff(1 if _viscous(term) else 2, count) for k, term in tested.items()}

    def value(chosen: tuple[int, ...]) -> float:
        return gain_of(model, base, *chosen) - sum(prices[k] for k in chosen)

    chosen: tuple[int, ...] = ()
    while True:
        moves = [(*chosen, k) for k in tested if k not in chosen]
        moves += [tuple(k for k in chosen if k != out) for out in chosen]
        best = max(moves, key=value, default=chosen)
        if value(best) > value(chosen):
            chosen = best
            continue
        solution = model.solution((*base, *chosen))
        wrong = [k for k in chosen if solution[k] < 0.0 and not _viscous(tested[k])]
        if not wrong:
            return chosen, value(chosen)
        tested = {k: term for k, term in tested.items() if k not in wrong}
        chosen = tuple(k for k in chosen if k not in wrong)


def _viscous(term: Term) -> bool:
    return term.expr.is_polynomial() and len(term.expr.free_symbols) == 1


def unmodelled_friction(term: Term, **figures: float) -> Finding:
    """Names a candidate for dissipation; the figures are its coefficient and, where known, its gain."""
    return find("unmodelled-friction", term.text, velocities=_rates(term), **figures)


def _rates(term: Term) -> list[str]:
    return sorted(symbol.name for symbol in term.expr.free_symbols)


def usual_friction(columns: EulerLagrange) -> list[Term]:
    """Viscous and dry friction and drag on each velocity, and dampers between two, that are no candidates."""
    rates = [f"{name}_dot" for name in columns.coordinates]
    driven = {rates[i] for i in columns.prescribed}
    usual = [text for v in rates if v not in driven for text in (f"{v}**2/2", f"abs({v})", f"abs({v})**3/3")]
    usual += [f"({v}-{w})**2/2" for v, w in combinations(rates, 2) if not {v, w} <= driven]
    library = Library([columns.terms[0].text], columns.coordinates, dissipation=usual)
    given = {_kind(term.expr) for term in columns.terms if term.kind == "dissipation"}
    return [term for term in library.dissipation if _kind(term.expr) not in given]


def _kind(friction: sp.Expr) -> sp.Expr:
    """Friction without its factor and with |v| where that was smoothed."""
    roots = {
        root: sp.Abs(*root.free_symbols)
        for root in friction.atoms(sp.Pow)
        if root.exp == sp.Rational(1, 2) and len(root.free_symbols) == 1
    }
    return sp.expand(friction.xreplace(roots)).primitive()[1]


class _Late:
    """Residual that delayed forces leave in the equations: f(t − τ) ≈ f − τ ḟ."""

    def __init__(self, rates: np.ndarray) -> None:
        self.rates = rates

    def __len__(self) -> int:
        return 1

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        return self.rates[intervals].transpose(2, 1, 0).reshape(1, n_dof, -1)

    def within(self, intervals: slice) -> _Late:
        return _Late(self.rates[intervals])


def late_forces(effects: Effects, relevance: float) -> list[Finding]:
    """Forces that act later, or earlier, than their times say."""
    fit = effects.fit
    if fit.grid.forces is None:
        return []
    rates = rates_of_forces(fit)
    chosen = fit.problem.candidates.subset(list(fit.structure))
    late = WithPushes(chosen, _Late(rates))
    model, base = beside(fit, late)
    gain = gain_of(model, base, len(base))
    if gain <= chi_square_cutoff() + fit.relevant_gain(relevance):
        return []
    delay = float(model.solution((*base, len(base)))[len(base)])
    held = abs(delay / fit.problem.trajectories.sampling_interval - 0.5) < DIAGNOSIS.half_a_sample
    share = effects.of_force(abs(delay) * np.sqrt(np.square(rates).mean(axis=(0, 1))))
    figures = {"delay": delay, "half_a_sample": held, "gain": gain, "share": share}
    slight = effects.slight(share, gain)
    return [find("slight-delay", **figures) if slight else find("late-forces", **figures)]


def wrong_known(fit: Fit) -> list[Cause]:
    """Known coefficients without which the motion is explained better, or by fewer terms.

    Where no force acts and one coefficient is known there is nothing to test: it sets the scale.
    """
    known = np.flatnonzero(fit.problem.is_known)
    if not known.size or (fit.grid.forces is None and known.size < 2):
        return []
    out: list[Cause] = []
    tested = known[:_MOST_RELEASED]
    for k in tested:
        released = fit.grid.posed(fit.problem.releasing(int(k)))
        found = refine(released.fit(fit.structure.with_([int(k)]), fit.start))
        gain = 2.0 * (value(found) - value(fit))
        fewer = len(fit.structure) + 1 - len(found.structure)
        # a known term that is dropped once it is free makes room for terms that imitate a missing one
        holds = k in found.structure and equations_hold(found)
        # as with a missing term: the right law needs no more terms, or holds where this one does not
        likely = fewer >= 0 or (holds and not equations_hold(fit))
        if not (likely and gain > chi_square_cutoff(1, len(tested))):
            continue
        estimate, text = found.coefficients[k], fit.problem.terms[int(k)].text
        ratio = estimate / fit.problem.known[k]
        wrong = find(
            "wrong-known-coefficient",
            text,
            given=fit.problem.known[k],
            estimate=estimate,
            fewer_terms=max(fewer, 0),
            gain=gain,
            force_factor=ratio if fit.grid.forces is not None and ratio > 0.0 else None,
        )
        out.append(Cause(wrong, gain, holds))
    return out
