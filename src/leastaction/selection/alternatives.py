"""The structures about a fit, of every size: what the trade-off curve shows.

Costs come from the quadratic model of the likelihood about the fit. Only structures whose equations can be
solved for q̈ along the motion are kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import symmetric_inverse
from leastaction.estimation.problem import Structure
from leastaction.selection.likelihood_refinement import Neighbourhood, penalty, value
from leastaction.selection.likelihood_search import Choice, trade_off
from leastaction.selection.strategies.irrelevant_terms import price_of_terms

__all__ = ["Alternative", "find_alternatives"]

_FITTED = 3  # of those that the quadratic model prefers to the fit
_EXCHANGED = 64  # structures tested if no other of the fit's size is solvable
_SHOWN = 3  # of those that can be
_GAIN = 1e-3  # of −2 log likelihood: less is rounding


@dataclass(frozen=True, eq=False)
class Alternative:
    """A structure beside the chosen one.

    Attributes
    ----------
    structure : Structure
    cost : float
        −2 log likelihood relative to the chosen structure.
    criterion : float
        The same with the price of the terms.
    coefficients : (n_candidates,) array
    standard_errors : (n_members,) array
    reason : str
        Why it was not chosen: "chosen", "fits-worse", "not-worth-its-terms", "irrelevant" (its further terms
        remove less than the relevant share of the equation error), "no-fit" (its own fit does not converge),
        "fit-is-worse" (its own fit does not bear out what the quadratic model promised), "fit-is-better" (the
        search ended before it) or "not-fitted" (the quadratic model prefers it; its own fit was not made).
    """

    structure: Structure
    cost: float
    criterion: float
    coefficients: np.ndarray
    standard_errors: np.ndarray
    reason: str


def find_alternatives(fit: Fit, relevance: float) -> tuple[tuple[Alternative, ...], np.ndarray]:
    """The structures of every size about a fit, in rising size, best first in each; with the fit's own.

    Returns
    -------
    tuple of Alternative
    (n_candidates, n_candidates) array
        Matrix of the quadratic model about the fit; the rest of it is large for long recordings.
    """
    near = Neighbourhood.of(fit)
    price, share = penalty(fit.grid), price_of_terms(fit, relevance)
    levels = trade_off(near.model, near.here)
    base = next(c.cost for c in levels[len(near.here)] if c.members == near.here)
    surcharges = near.model.surcharges
    out: list[Alternative] = []
    unfitted = _FITTED
    parameters_of = fit.problem.parameters_of  # a shape parameter costs as much as a term
    for size, level in sorted(levels.items()):
        solvable = [c for c in level if c.members == near.here or near.regular(c.members)]
        if size == len(near.here) and len(solvable) == 1:
            solvable += _exchanged(near)
        for choice in solvable:
            structure = near.structure(choice.members)
            cost, more = choice.cost - base, parameters_of(structure) - parameters_of(fit.structure)
            reason = _reason(near, choice.members, cost, more, price, share)
            if reason == "" and unfitted:
                reason, unfitted = _outcome(near, choice.members), unfitted - 1
            index = list(choice.members)
            dearer = float(surcharges[index].sum() - surcharges[list(near.here)].sum())
            inverse = symmetric_inverse(near.quadratic.matrix[np.ix_(index, index)])
            out.append(
                Alternative(
                    structure,
                    cost - dearer,
                    cost + price * more,
                    near.coefficients(choice.members),
                    np.sqrt(np.diag(inverse)),
                    reason or "not-fitted",
                )
            )
    return tuple(out), near.quadratic.matrix


def _exchanged(near: Neighbourhood) -> list[Choice]:
    """Structures with one term exchanged, cheapest first.

    Terms that cancel the known ones explain any data with L = 0. Where the motion is small they take all
    places among the best of a size.
    """
    ranked = near.model.best(near.model.neighbours(near.here).exchanged(_EXCHANGED), _EXCHANGED)
    return list(islice((c for c in ranked if near.regular(c.members)), _SHOWN))


def _reason(
    near: Neighbourhood, members: tuple[int, ...], cost: float, more: int, price: float, share: float
) -> str:
    """Why a structure was not chosen, by the quadratic model; empty where the model prefers it."""
    if members == near.here:
        return "chosen"
    if cost + price * more > -_GAIN:
        return "not-worth-its-terms" if more > 0 else "fits-worse"
    if more > 0 and cost > -share * more:
        return "irrelevant"
    return ""


def _outcome(near: Neighbourhood, members: tuple[int, ...]) -> str:
    """Outcome of the fit of a structure."""
    fit = near.fit
    other = fit.grid.fit(near.structure(members), near.start(members))
    if not other.converged or not np.isfinite(value(other)):
        return "no-fit"
    return "fit-is-worse" if value(other) <= value(fit) else "fit-is-better"
