"""From a structure to better ones: fits in turn with searches on the quadratic model of the likelihood.

About a fit the curve is eliminated and the cost is a quadratic in the coefficients of *all* candidates
(:mod:`leastaction.selection.likelihood_search`), so thousands of structures are compared without a fit. The
best are fitted in turn, until nothing is better.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from leastaction.errors import StopSearch
from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import Quadratic
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.shapes import fit_shapes
from leastaction.estimation.weights import Start
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.likelihood_search import Choice, QuadraticModel, search_subsets, term_penalty
from leastaction.selection.progress import Progress, law_so_far, silent
from leastaction.selection.settings import SELECTION

if TYPE_CHECKING:
    from leastaction.selection.weak_proposals import Proposal

__all__ = ["Neighbourhood", "best_structure", "penalty", "refine", "value"]

_PROPOSED = 2  # structures fitted a round, at most


def penalty(grid: Grid) -> float:
    """Price of a term in units of χ², but for the surcharges of its problem."""
    searched = int(np.count_nonzero(~grid.problem.is_known))
    return term_penalty(int(grid.observations.counts.sum()), searched)


def value(fit: Fit) -> float:
    """Evidence less the price of the terms; −inf for a fit that failed or has lost its scale.

    A fit that is still moving counts: the next structure is begun from it.
    """
    if not fit.usable or not np.isfinite(fit.evidence):
        return -np.inf
    # candidates that imitate the known term leave the scale of L undetermined
    if np.all(np.abs(fit.estimates) < SELECTION.scale_lost * fit.standard_errors):
        return -np.inf
    n_parameters = fit.problem.parameters_of(fit.structure)
    surcharge = float(fit.problem.surcharges[list(fit.structure)].sum())
    return fit.evidence - 0.5 * penalty(fit.grid) * n_parameters - 0.5 * surcharge


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The quadratic model of the cost about a fit, over the free candidates of its problem.

    Attributes
    ----------
    fit : Fit
    quadratic : Quadratic
    model : QuadraticModel
    """

    fit: Fit
    quadratic: Quadratic
    model: QuadraticModel

    @classmethod
    def of(cls, fit: Fit) -> Neighbourhood:
        """Score every candidate about a fit."""
        quadratic = fit.quadratic
        free = fit.problem.free
        about = quadratic.matrix, quadratic.gradient, fit.coefficients[free]
        return cls(fit, quadratic, QuadraticModel(*about, fit.problem.surcharges[free]))

    @property
    def here(self) -> tuple[int, ...]:
        """Positions of the fit's structure among the free candidates."""
        return self.positions(self.fit.structure)

    def positions(self, structure: Structure) -> tuple[int, ...]:
        """Where the members of a structure are among the free candidates."""
        return tuple(int(p) for p in np.searchsorted(self.fit.problem.free, structure.members))

    def structure(self, positions: Sequence[int]) -> Structure:
        """The structure at positions among the free candidates."""
        return Structure(self.fit.problem.free[list(positions)])

    def coefficients(self, positions: tuple[int, ...]) -> np.ndarray:
        """(n_candidates,) coefficients that the model expects of a structure."""
        out = self.fit.coefficients.copy()
        out[self.fit.problem.free] = self.model.solution(positions)
        return out

    def start(self, positions: tuple[int, ...]) -> Start:
        """Curve and coefficients after the step of the model to another structure."""
        free = self.fit.problem.free
        coefficients = self.coefficients(positions)
        step = (coefficients - self.fit.coefficients)[free]
        shift = self.quadratic.curve_step(step)
        points = self.fit.control_points
        return Start(points - shift.reshape(points.shape), coefficients, self.fit.weights)

    def regular(self, positions: tuple[int, ...]) -> bool:
        """Whether the equations of a structure can be solved for q̈ along most of the motion."""
        return self.fit.regular(self.coefficients(positions)) > ESTIMATION.mostly_regular

    def better(self, price: float) -> Iterator[tuple[Structure, Start]]:
        """Better structures, with their starts: the best, one near by, the second best.

        Far from the law the best may be a heap of terms whose fit fails; then the best with one term more
        than now, at most, is a step on firmer ground, and after it the best with none more.
        """
        levels = search_subsets(self.model, self.here, price)
        regular = (self._first_regular(level) for level in levels.values())
        ranked = sorted(filter(None, regular), key=lambda c: c.criterion(price))
        here = next((n for n, choice in enumerate(ranked) if choice.members == self.here), len(ranked))
        better, size = ranked[:here], len(self.here)
        near = [c for c in better if len(c.members) <= size + 1]
        no_larger = [c for c in better if len(c.members) <= size]
        chosen = (*better[:1], *near[:1], *better[1:_PROPOSED], *no_larger[:1])
        for positions in dict.fromkeys(c.members for c in chosen):
            yield self.structure(positions), self.start(positions)

    def _first_regular(self, level: list[Choice]) -> Choice | None:
        return next((choice for choice in level if self.regular(choice.members)), None)


def refine(fit: Fit, report: Progress = silent, rounds: int = 8, most: int | None = None) -> Fit:
    """Fit better structures until none is found; ``most`` limits the proposals fitted in a round."""
    for _ in range(rounds):
        try:
            tell(fit, report)
        except StopSearch as stop:
            stop.fit = fit
            raise
        if not fit.usable:
            break
        better = _better(fit, most)
        if better is None:
            break
        fit = better
    return fit


def tell(fit: Fit, report: Progress) -> None:
    """Show a structure that was fitted."""
    report("select", law_so_far(fit.problem, fit.coefficients, fit.evidence))


def _better(fit: Fit, most: int | None) -> Fit | None:
    """The first proposal that converges to a higher value; otherwise the best unconverged one."""
    now, moving = value(fit), None
    proposals = Neighbourhood.of(fit).better(penalty(fit.grid))
    for n, (structure, start) in enumerate(proposals):
        if n == most:
            break
        other = fit.grid.fit(structure, start)
        if value(other) <= now:
            continue
        if other.converged:
            return other
        if moving is None or value(other) > value(moving):
            moving = other
    return moving


def best_structure(proposals: Iterable[Proposal], best: Fit | None, report: Progress) -> Fit:
    """Refine proposals (with ``grid``, ``structure``, ``start`` and ``evidence``), starting with the best.

    Ends when two of them lead to the same structure.
    """
    for proposal in proposals:
        if best is not None and not np.isfinite(proposal.evidence):
            continue
        try:
            # numbers first: beside wrong ones, terms that make up for them are worth their price
            fit = refine(fit_shapes(proposal.grid.fit(proposal.structure, proposal.start)), report)
        except StopSearch as stop:
            stop.fit = best or stop.fit
            raise
        agreed = best is not None and fit.structure == best.structure
        if best is None or value(fit) > value(best):
            best = fit
        if agreed:
            break
    assert best is not None
    return best


def beside(fit: Fit, candidates: EulerLagrange) -> tuple[QuadraticModel, tuple[int, ...]]:
    """Quadratic model of the likelihood: chosen terms, those behind them; and places of the chosen."""
    quadratic, chosen = fit.score(candidates), len(fit.structure)
    here = np.concatenate([fit.estimates, np.zeros(len(candidates) - chosen)])
    model = QuadraticModel(quadratic.matrix, quadratic.gradient, here)
    return model, tuple(range(chosen))


def gains_beside(fit: Fit, candidates: EulerLagrange, size: int) -> np.ndarray:
    """By how much −2 log likelihood falls with each so many columns in a row behind the chosen terms."""
    model, here = beside(fit, candidates)
    places = range(len(here), len(candidates), size)
    return np.array([gain_of(model, here, *range(k, k + size)) for k in places])


def gain_of(model: QuadraticModel, members: tuple[int, ...], *more: int) -> float:
    """By how much further terms lower −2 log likelihood."""
    return model.best({members}, 1)[0].cost - model.best({(*members, *more)}, 1)[0].cost
