"""Other structures that these data support as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from leastaction.diagnosis.effects import Effects
from leastaction.diagnosis.shapes import chance, laws_in_play
from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem
from leastaction.estimation.volume import positive_definite
from leastaction.findings import Finding, find
from leastaction.mechanics.euler_lagrange import Points
from leastaction.selection.alternatives import Alternative
from leastaction.selection.search_state import equations_exact

__all__ = ["rival_warnings"]

_MOST = 3  # rivals that are named
_REFUTED = frozenset({"no-fit", "fit-is-worse"})  # alternatives whose own fit contradicts the quadratic model
_STATES = 400  # along the motion, at which they are compared
_REACH = (1.0, 2.0, 3.0)  # times the recorded states


def rival_warnings(
    effects: Effects, alternatives: Sequence[Alternative], others: Sequence[Fit]
) -> list[Finding]:
    """One finding for each rival, the most likely first; a note where terms that hardly matter compete.

    A rival R is a structure that the data do not exclude as the law.  Were it the law, the chosen structure S
    would be the likelier by chance only: by no more than S ∪ R is, whose further |S ∖ R| terms were taken
    from the candidates outside of R.  So R stays in play as long as it loses less than that test allows.

    Rivals have as many terms as S or, with shape parameters, as many numbers, or one more: where the motion
    shows little, the law itself may lose by the price of a term.  It is then likelier than S with any further
    term, which follows the noise only.  Its own fit, if one was made, has to agree: the quadratic model fails
    far from S.  Not where the library is inexact: there a further term always helps.

    The others are laws that the search found with other shape parameters, see `laws_in_play`.
    """
    fit = effects.fit
    chosen = fit.structure
    size, parameters_of = len(chosen), fit.problem.parameters_of
    numbers = parameters_of(chosen)
    same = [a for a in alternatives if len(a.structure) == size or parameters_of(a.structure) == numbers]
    rivals = [a for a in same if a.structure != chosen and a.cost < chance(fit, chosen.without(a.structure))]
    if equations_exact(fit):
        larger = [a for a in alternatives if a not in same and parameters_of(a.structure) == numbers + 1]
        larger = [a for a in larger if a.reason not in _REFUTED]
        extended = min((a.cost for a in larger if chosen <= a.structure), default=0.0)
        rivals += [a for a in larger if a.cost < min(0.0, extended)]
    texts = [term.offered for term in fit.problem.terms]
    out: list[Finding] = []
    for rival in rivals[:_MOST]:
        mine = [texts[m] for m in chosen if m not in rival.structure]
        theirs = [texts[m] for m in rival.structure if m not in chosen]
        law = fit.problem, rival.coefficients
        out.append(_rival(effects, list(chosen.without(rival.structure)), mine, theirs, *law))
    named = [rival.structure for rival in rivals[:_MOST]]
    for other, apart, theirs in laws_in_play(fit, [o for o in others if o.structure not in named]):
        texts = _texts(fit, apart), _texts(other, theirs)
        out.append(_rival(effects, apart, *texts, other.problem, other.coefficients))
    return out


def _rival(
    effects: Effects,
    apart: list[int],
    mine: list[str],
    theirs: list[str],
    problem: Problem,
    coefficients: np.ndarray,
) -> Finding:
    """A law that the data do not exclude, and where it differs from the fit."""
    state = _where_they_differ(effects.fit, problem, coefficients)
    figures = {"others": theirs, "at_names": list(state), "at_values": list(state.values())}
    minor = effects.minor(apart)
    return find("slight-rival", mine, **figures) if minor else find("competing-structures", mine, **figures)


def _texts(fit: Fit, members: list[int]) -> list[str]:
    """Terms with their shape parameters, to three digits."""
    numbers = {name: float(f"{x:.3g}") for name, x in fit.problem.shape_values.items()}
    return [fit.problem.terms[m].at(numbers).text for m in members]


def _where_they_differ(fit: Fit, problem: Problem, coefficients: np.ndarray) -> dict[str, float]:
    """The state, up to three times as far out as recorded, at which other accelerations differ most.

    Empty if they differ nowhere, or are laws of groups of trials.
    """
    if fit.problem.candidates.grouped:
        return {}
    spline = fit.grid.spline
    some = slice(None, None, max(1, spline.n_intervals // _STATES))
    q, qdot, qddot = (s[:, 0] for s in spline.at_quadrature(fit.control_points, some))
    middle = q.mean(axis=0)
    states = np.concatenate([np.stack([middle + reach * (q - middle), reach * qdot]) for reach in _REACH], 1)
    times = np.tile(spline.points[some, 0], len(_REACH))
    points = Points(states[0], states[1], np.zeros_like(states[0]), times)
    with np.errstate(all="ignore"):
        apart = _acceleration(fit.problem, points, fit.coefficients)
        apart -= _acceleration(problem, points, coefficients)
    size = np.sqrt((qddot**2).mean(axis=0))
    apart = np.linalg.norm(apart / np.maximum(size, 1e-300), axis=1)
    if not np.isfinite(apart).any():
        return {}
    worst = int(np.nanargmax(np.where(np.isfinite(apart), apart, np.nan)))
    names = fit.problem.trajectories.coordinates
    return dict(zip([*names, *(f"{n}_dot" for n in names)], states[:, worst].ravel().tolist(), strict=True))


def _acceleration(problem: Problem, at_rest: Points, coefficients: np.ndarray) -> np.ndarray:
    """(n_points, n_dof) free accelerations at (q, q̇); NaN where the mass matrix is not positive definite."""
    bias = np.tensordot(coefficients, problem.candidates.strong(at_rest), 1).T
    mass = problem.candidates.mass_matrix(at_rest, coefficients)
    usable = positive_definite(mass) & np.isfinite(bias).all(axis=1)
    out = np.full(bias.shape, np.nan)
    out[usable] = -np.linalg.solve(mass[usable], bias[usable][:, :, None])[:, :, 0]
    return out
