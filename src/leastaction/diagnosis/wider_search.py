"""A search begun anew, with common terms and friction where the candidates do not explain the data.

Tests on the final fit (`missing_terms`, `friction`) add a little to a structure that is nearly right.  One
that is far from the law is no start for that, and imitates what is missing: the search begins from the data
again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import sympy as sp

from leastaction.curve.smoothing import Smooth
from leastaction.diagnosis.friction import unmodelled_friction, usual_friction
from leastaction.diagnosis.missing_terms import common_terms, missing_term
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.findings import Finding, find
from leastaction.identifiers import ANGLE_NAMES
from leastaction.library import Term
from leastaction.selection.families import searched_with
from leastaction.selection.forecast_error import forecast_error
from leastaction.selection.progress import silent
from leastaction.selection.search_state import Search, equations_hold, restarted
from leastaction.selection.significance import chi_square_cutoff
from leastaction.selection.strategies import feeding_friction, weak_start
from leastaction.selection.weak_proposals import explicable

__all__ = [
    "MOST_SAMPLES",
    "begun_anew",
    "perhaps_angles",
    "perhaps_degrees",
    "search_afresh",
    "undeclared_angles",
]

MOST_SAMPLES = 50_000  # a search on more takes too long for a hint


def begun_anew(search: Search, grid: Grid, curve: Smooth | None = None) -> Fit | None:
    """What is found on a grid of all data, if its equations hold and every term is certain.

    It has to be likelier than the fit that is in doubt, by more than chance.  What explains the motion no
    better may still move the unexplained from the equations to the noise, as vibrations can be either, or
    hide it behind large terms that cancel each other.
    """
    begun = restarted(replace(search, report=silent), grid, curve)
    if not explicable(begun.grid, begun.curve, begun.seed):
        return None
    found = searched_with(begun, weak_start, feeding_friction).found
    if not (found.converged and equations_hold(found)):
        return None
    before = search.found
    same = found.grid.knots_per_second == before.grid.knots_per_second
    chance = 0.5 * chi_square_cutoff()
    if same and before.converged and not found.evidence > before.evidence + chance:
        return None
    certain = np.abs(found.estimates) >= DIAGNOSIS.certain * found.standard_errors
    return found if np.all(certain) else None


def search_afresh(search: Search) -> list[Finding]:
    """Say which common terms, and which friction, lead to equations that hold; nothing if none do."""
    return _searched(search, search.found.problem.candidates.turning)


def undeclared_angles(search: Search, names: Sequence[str]) -> list[Finding]:
    """The same if some coordinates that nobody called angles are taken for angles."""
    columns = search.found.problem.candidates
    turning = [name for name in columns.coordinates if name in {*names, *columns.turning}]
    return _searched(search, turning) if len(turning) > len(columns.turning) else []


def perhaps_angles(problem: Problem) -> list[str]:
    """Coordinates named like angles that were not declared as such and occur in no sine or cosine."""
    plain = [n for n in problem.coordinates if n not in (*problem.angles, *problem.candidates.turning)]
    return [name for name in plain if name.lower().startswith(ANGLE_NAMES)]


def perhaps_degrees(fit: Fit, period: float, share: np.ndarray, causes: Sequence[Finding]) -> list[Finding]:
    """Measured angles that cover more than two turns within a recording, which may be in degrees.

    Where simulations follow the data, the unit of the angle hardly matters, with two exceptions. An equation
    that is off by more than its forces explains nothing, even if a simulation happens to follow. And small
    swings in degrees nearly follow the law of a spring: the angle is outside of sines and cosines, and no
    other cause is found for an equation that is off.
    """
    spans = np.max([np.ptp(curve, axis=0) for curve in fit.curves()], axis=0)
    names, counts = fit.problem.trajectories.coordinates, fit.grid.observations.counts
    found = {
        name: find("angle-in-degrees", name, span=span)
        for name, span, count in zip(names, spans, counts[: len(names)], strict=True)
        if count and name in fit.problem.candidates.turning and span > DIAGNOSIS.two_turns
    }
    lagrangian = [
        term for term in map(fit.problem.terms.__getitem__, fit.structure) if term.kind == "lagrangian"
    ]
    suspect = outside_sines([] if causes else lagrangian)
    suspect |= {name for name, part in zip(names, share, strict=True) if part >= 1.0}
    follows = found and fit.converged and forecast_error(fit, period) <= DIAGNOSIS.follows
    return [finding for name, finding in found.items() if name in suspect or not follows]


def outside_sines(terms: Sequence[Term]) -> frozenset[str]:
    """Names that terms contain outside of sines and cosines.

    Examples
    --------
    >>> from leastaction.library import make_term
    >>> sorted(outside_sines([make_term("a**2*cos(b)", ["a", "b"])]))
    ['a']
    """
    plain: list[sp.Expr] = []
    for term in terms:
        waves = cast("Iterable[sp.Expr]", term.expr.atoms(sp.sin, sp.cos))
        plain.append(term.expr.xreplace({wave: sp.Integer(1) for wave in waves}))
    return frozenset(str(symbol) for expr in plain for symbol in expr.free_symbols)


def _searched(search: Search, turning: Sequence[str]) -> list[Finding]:
    fit = search.found
    columns = fit.problem.candidates
    # dry friction has a kink, which a curve meets only where it is smoothed
    usual = [term for term in usual_friction(columns) if not isinstance(term.expr, sp.Abs)]
    more = [*common_terms(columns, "standard", turning), *usual]
    if not more:
        return []
    found = begun_anew(search, fit.grid.posed(fit.problem.wider(more)))
    if found is None:
        return []
    new = [found.problem.terms[m] for m in found.structure if m >= len(columns)]
    terms = [term for term in new if term.kind == "lagrangian"]
    out: list[Finding] = []
    if terms:
        angles = [name for name in columns.of(terms).turning if name not in columns.turning]
        figures = {"angles": angles} if angles else {}
        texts = [term.text for term in terms]
        out.append(missing_term(texts, columns.coordinates, free_terms=len(found.structure), **figures))
    values = {found.problem.terms[m]: float(found.coefficients[m]) for m in found.structure}
    friction = [term for term in new if term.kind == "dissipation"]
    return out + [unmodelled_friction(term, coefficient=values[term]) for term in friction]
