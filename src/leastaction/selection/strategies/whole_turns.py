"""Whether the law needs powers of angles, which a whole turn changes.

A grammar also offers θ, θ² and θφ, for springs and constant torques.  On a machine, every law leaves
something unexplained.  Powers of angles together imitate a part of that, and a search among all candidates
keeps them.  They are therefore ruled out where a law begins as well without them.  They stay out if, on the
final knots, the equations hold to one per cent and all powers together do not make them exact.  Where finer
knots have followed vibrations, a search on a coarse grid judges.

Cost: that of `weak_start`, whose place it takes; where powers are proposed, a second set of weak forms; a fit
with all powers. Skipped where a library has no description lengths or no angles.
Without it (`docs/ablations.md`) the law of the measured triple pendulum has powers of two angles instead of
their cosines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import sympy as sp

from leastaction.estimation.problem import Problem
from leastaction.library import Term
from leastaction.selection.likelihood_refinement import penalty, value
from leastaction.selection.search_state import Search, equations_exact, equations_hold
from leastaction.selection.strategies import weak_start

__all__ = ["powers_of_angles", "run"]


def run(search: Search) -> Search:
    """A start, without powers of angles if that is as good; later, allow them unless its law holds."""
    powers = powers_of_angles(search.problem)
    if not powers:
        return search
    if search.fit is None:
        return _begun(search, powers)
    if search.vibrates or not {*powers} <= search.problem.excluded:
        return search
    fit = search.found
    allowed = fit.posed(fit.problem.allowing(powers))
    if fit.converged and equations_hold(fit) and not equations_exact(fit):
        wider = allowed.grid.fit(fit.structure.with_(powers), fit.start)
        if not (wider.converged and equations_exact(wider)):
            return search
    return search.posed(lambda problem: problem.allowing(powers)).now(allowed)


def powers_of_angles(problem: Problem) -> list[int]:
    """Candidates of L that a whole turn of an angle changes, in a library grown from names."""
    if problem.lengths is None or not problem.angles:
        return []
    of_l = [k for k, term in enumerate(problem.terms) if term.kind == "lagrangian"]
    return [k for k in of_l if not problem.is_known[k] and _changes(problem.terms[k], problem.angles)]


def _changes(term: Term, angles: Sequence[str]) -> bool:
    turning = [symbol for symbol in term.expr.free_symbols if str(symbol) in angles]
    return any(term.expr.subs(symbol, symbol + 2 * sp.pi) != term.expr for symbol in turning)


def _begun(search: Search, powers: Sequence[int]) -> Search:
    """The best structure on the first grid, without powers of angles if the best start is as good."""
    narrow = search.posed(lambda problem: problem.excluding(powers))
    proposals = weak_start.proposals(search)
    first = proposals[0]
    if not {*powers} & {*first.structure}:
        others = [replace(p, grid=narrow.grid) for p in proposals if not {*powers} & {*p.structure}]
        return weak_start.refined(narrow, others)
    others = weak_start.proposals(narrow)
    with_powers, without = (p.grid.fit(p.structure, p.start) for p in (first, others[0]))
    as_good = value(without) > value(with_powers) - 0.5 * penalty(search.grid)  # the price of a term
    return weak_start.refined(narrow, others) if as_good else weak_start.refined(search, proposals)
